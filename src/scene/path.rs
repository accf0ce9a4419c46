//! References from one file to another, kept inside a folder.

use std::path::{Path, PathBuf};

/// Resolves `reference`, as written in a file of `folder`, to an existing file inside `folder`.
///
/// Scene files come from strangers: an absolute path, a `..` that leaves the folder or a link that does would let
/// them read any file. Back slashes count as slashes.
///
/// # Errors
/// A sentence for a message: the reference leaves the folder, or there is no such file.
pub(crate) fn inside(folder: &Path, reference: &str) -> Result<PathBuf, String> {
    let reference = reference.replace('\\', "/");
    let mut depth = 0_i32;
    for part in reference.split('/') {
        match part {
            "" | "." => {}
            ".." => depth -= 1,
            _ => depth += 1,
        }
        if depth < 0 {
            break;
        }
    }
    if depth < 0 || reference.starts_with('/') || reference.as_bytes().get(1) == Some(&b':') {
        return Err("it lies outside the scene's folder".into());
    }
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let path = folder.join(&reference);
    let real = path.canonicalize().map_err(|_| "there is no such file".to_string())?;
    let root = folder.canonicalize().map_err(|_| "there is no such folder".to_string())?;
    if !real.starts_with(root) {
        return Err("it lies outside the scene's folder".into());
    }
    if !real.is_file() {
        return Err("it is not a file".into());
    }
    Ok(path)
}

/// The folder that `file` lies in.
pub(crate) fn folder(file: &Path) -> &Path {
    file.parent().unwrap_or(Path::new(""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn references_that_leave_the_folder_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("in")).unwrap();
        std::fs::write(dir.path().join("secret"), "x").unwrap();
        std::fs::write(dir.path().join("in/a b.png"), "x").unwrap();
        let root = dir.path().join("in");
        for bad in ["../secret", "x/../../secret", "/etc/passwd", "C:/x", "..\\secret", "missing", "."] {
            assert!(inside(&root, bad).is_err(), "{bad}");
        }
        assert!(inside(&root, "./a b.png").is_ok());
        assert!(inside(&root, "x/../a b.png").is_err(), "x does not exist");
    }

    #[cfg(unix)]
    #[test]
    fn a_link_out_of_the_folder_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("in")).unwrap();
        std::fs::write(dir.path().join("secret"), "x").unwrap();
        std::os::unix::fs::symlink(dir.path().join("secret"), dir.path().join("in/link")).unwrap();
        assert!(inside(&dir.path().join("in"), "link").is_err());
    }
}
