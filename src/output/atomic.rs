//! Output files that are whole or absent: written beside their place, moved there together at the end.

use std::{
    ffi::OsStr,
    fs::{self, File},
    hash::{BuildHasher, Hasher, RandomState},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

use crate::{Error, Result, lock::Lock};

/// The folder of a file.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Folder and name of an output file.
///
/// # Errors
/// [`Error::Option`] if the path is that of a folder or a device, which would be lost; or if the name is no UTF-8: others are
/// made of it.
pub fn place_of(path: &Path) -> Result<(&Path, &str)> {
    let wrong = |what: &str| Err(Error::Option(format!("{}: {what}", path.display())));
    let name = match path.file_name().map(OsStr::to_str) {
        Some(Some(name)) => name,
        Some(None) => return wrong("the name of an output file must be UTF-8; choose another one"),
        None => return wrong("is a folder; a file name was expected"),
    };
    match fs::metadata(path) {
        Ok(there) if there.is_dir() => wrong("is a folder; a file name was expected"),
        Ok(there) if !there.is_file() => wrong("is no regular file; choose another name"),
        _ => Ok((folder_of(path), name)),
    }
}

/// Proves that an output file is none of `inputs`, which would be lost.
///
/// # Errors
/// [`Error::Option`] if it is one.
pub fn check_is_no_input(output: &Path, inputs: &[&Path]) -> Result<()> {
    let Ok(place) = output.canonicalize() else { return Ok(()) };
    match inputs.iter().any(|input| input.canonicalize().is_ok_and(|input| input == place)) {
        true => Err(Error::Option(format!("{}: is read by this command; choose another name", output.display()))),
        false => Ok(()),
    }
}

/// A set of output files of one folder.
///
/// Every file is written under a temporary name in the folder. [`Staged::commit`] moves all of them to their places,
/// so a failed run leaves what was there before. Dropping without a commit removes the temporary files, and the
/// folder too if [`Staged::open`] made it.
///
/// The file that was written last stands for all of them: it goes first from the place of its forerunner, and comes to it
/// last. Where it is, the whole set is there, of one run, even if a commit was ended by a power cut.
pub struct Staged {
    /// Goes before the folder does.
    lock: Option<Lock>,
    folder: PathBuf,
    /// What no other set has in its temporary names: processes of other machines and containers may have our number.
    random: u64,
    /// Folders that were made, outermost first.
    made: Vec<PathBuf>,
    /// (temporary, final) paths.
    files: Vec<(PathBuf, PathBuf)>,
}

impl Staged {
    /// Makes the folder if it is missing, and proves that files can be written in it: a long computation should not
    /// fail at its end for want of rights.
    ///
    /// # Errors
    /// [`Error::Io`] with the folder's path: it is a file, or cannot be made or written.
    pub fn open(folder: &Path) -> Result<Staged> {
        let random = RandomState::new().build_hasher().finish();
        let mut staged = Staged { lock: None, folder: folder.into(), random, made: Vec::new(), files: Vec::new() };
        if folder.exists() && !folder.is_dir() {
            return Err(Error::io(folder, io::Error::other("is a file; an output folder was expected")));
        }
        let missing: Vec<&Path> = folder.ancestors().take_while(|p| !p.as_os_str().is_empty() && !p.exists()).collect();
        for path in missing.into_iter().rev() {
            match fs::create_dir(path) {
                Ok(()) => staged.made.push(path.into()),
                // Another process was faster.
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists && path.is_dir() => {}
                Err(e) => return Err(Error::io(path, e)),
            }
        }
        let probe = staged.temporary("probe");
        let written = File::create(&probe).map_err(|e| Error::io(folder, e));
        fs::remove_file(&probe).ok();
        written.map(|_| staged)
    }

    /// As [`Staged::open`], for this process alone as long as it lives; `work` says what for. Temporary files that
    /// killed processes have left of the files that are written are removed.
    ///
    /// # Errors
    /// Those of [`Staged::open`]; [`Error::Busy`] if another process holds the folder.
    pub fn open_alone(folder: &Path, work: &str) -> Result<Staged> {
        let mut staged = Staged::open(folder)?;
        staged.lock = Some(Lock::folder(folder, work)?);
        Ok(staged)
    }

    /// As [`Staged::open`] for the folder of the file `path`, which is for this process alone as long as it lives; `work` says
    /// what for. Temporary files that killed processes have left of it are removed.
    ///
    /// # Errors
    /// Those of [`Staged::open`] and [`place_of`]; [`Error::Busy`] if another process holds the file.
    pub fn open_file(path: &Path, work: &str) -> Result<Staged> {
        let (folder, name) = place_of(path)?;
        let mut staged = Staged::open(folder)?;
        staged.lock = Some(Lock::take(path, folder.join(format!(".{name}.lock")), work)?);
        sweep(folder, name);
        Ok(staged)
    }

    /// Writes the file `name` with `fill` and flushes it to the disk.
    ///
    /// # Errors
    /// [`Error::Io`] with the file's final path.
    pub fn write(&mut self, name: &str, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
        self.write_path(name, |path| {
            let written = || {
                let mut out = BufWriter::with_capacity(1 << 16, File::create(path)?);
                fill(&mut out)?;
                out.into_inner()?.sync_all()
            };
            written().map_err(|e| Error::io(path, e))
        })
    }

    /// Has `write` make the file `name` at the path that it is given.
    ///
    /// # Errors
    /// Those of `write`, with the final path instead of the temporary one.
    pub fn write_path(&mut self, name: &str, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
        let (temporary, target) = (self.temporary(name), self.folder.join(name));
        if self.lock.is_some() {
            sweep(&self.folder, name);
        }
        // Listed first, so that the drop removes what a failure leaves.
        self.files.push((temporary.clone(), target.clone()));
        write(&temporary).map_err(|e| match e {
            Error::Io { source, .. } => Error::io(target, source),
            other => other,
        })
    }

    /// Moves all files to their places; returns these.
    ///
    /// # Errors
    /// [`Error::Io`] with the final path of the file that could not be moved.
    pub fn commit(mut self) -> Result<Vec<PathBuf>> {
        if let [_, .., (_, last)] = &self.files[..] {
            match fs::remove_file(last) {
                Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(Error::io(last, e)),
                _ => {}
            }
        }
        for (temporary, target) in &self.files {
            fs::rename(temporary, target).map_err(|e| Error::io(target, e))?;
        }
        // The names are on the disk too after this, where folders can be flushed; else they will be soon.
        File::open(&self.folder).and_then(|folder| folder.sync_all()).ok();
        self.made.clear();
        Ok(std::mem::take(&mut self.files).into_iter().map(|(_, target)| target).collect())
    }

    fn temporary(&self, name: &str) -> PathBuf {
        self.folder.join(format!(".{name}.{}.tmp", self.random))
    }
}

/// Removes what killed processes have left of the file `name` in `folder`, which nobody else writes.
pub(crate) fn sweep(folder: &Path, name: &str) {
    let left = |file: &str| {
        let file = file.strip_prefix('.')?;
        // Images are written beside the file that is to be theirs.
        let file = file.strip_prefix('.').unwrap_or(file);
        let numbers = file.strip_prefix(name)?.strip_prefix('.')?.strip_suffix(".tmp")?;
        let is_number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit() || b == b'-');
        numbers.split(".tmp.").all(is_number).then_some(())
    };
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.file_name().to_str().and_then(left).is_some() {
            fs::remove_file(entry.path()).ok();
        }
    }
}

impl Drop for Staged {
    fn drop(&mut self) {
        for (temporary, _) in &self.files {
            fs::remove_file(temporary).ok();
        }
        self.lock = None;
        for folder in self.made.iter().rev() {
            fs::remove_dir(folder).ok();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn files_appear_together_at_the_commit() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("a/b");
        let mut staged = Staged::open(&folder).unwrap();
        staged.write("one", |w| w.write_all(b"1")).unwrap();
        staged.write("two", |w| w.write_all(b"22")).unwrap();
        assert!(!folder.join("one").exists());
        staged.commit().unwrap();
        assert_eq!(names(&folder), ["one", "two"]);
        assert_eq!(fs::read(folder.join("two")).unwrap(), b"22");
    }

    #[test]
    fn a_failure_leaves_the_old_file_and_no_litter() {
        let root = tempfile::tempdir().unwrap();
        fs::write(root.path().join("one"), "old").unwrap();
        let mut staged = Staged::open(root.path()).unwrap();
        staged.write("one", |w| w.write_all(b"new")).unwrap();
        let error = staged.write("two", |w| {
            w.write_all(b"half")?;
            Err(io::Error::new(io::ErrorKind::StorageFull, "no space left"))
        });
        let message = error.unwrap_err().to_string();
        assert!(message.contains("two: no space left; the disk is full: make room"), "{message}");
        drop(staged);
        assert_eq!(names(root.path()), ["one"]);
        assert_eq!(fs::read(root.path().join("one")).unwrap(), b"old");
    }

    #[test]
    fn folders_that_were_made_vanish_without_a_commit() {
        let root = tempfile::tempdir().unwrap();
        let mut staged = Staged::open(&root.path().join("a/b")).unwrap();
        staged.write("one", |w| w.write_all(b"1")).unwrap();
        drop(staged);
        assert!(names(root.path()).is_empty());
    }

    #[test]
    fn sets_that_are_written_at_once_do_not_meet_and_each_is_whole() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("a/b/c");
        let barrier = std::sync::Barrier::new(8);
        std::thread::scope(|scope| {
            for k in 0..8u8 {
                let (barrier, folder) = (&barrier, &folder);
                scope.spawn(move || {
                    barrier.wait();
                    let mut staged = Staged::open(folder).unwrap();
                    staged.write("one", |w| (0..1000).try_for_each(|_| w.write_all(&[k; 100]))).unwrap();
                    barrier.wait();
                    staged.commit().unwrap();
                });
            }
        });
        assert_eq!(names(&folder), ["one"]);
        let bytes = fs::read(folder.join("one")).unwrap();
        assert!(bytes.len() == 100_000 && bytes.iter().all(|b| *b == bytes[0]));
    }

    #[test]
    fn what_a_killed_process_left_is_swept_and_nothing_else() {
        let root = tempfile::tempdir().unwrap();
        let other = [".one.x.tmp", ".one..tmp", ".three.7.tmp", ".tmp"];
        for name in [&other[..], &[".one.1.tmp", ".one.4194304.tmp", "..one.1.tmp.77-0.tmp"]].concat() {
            fs::write(root.path().join(name), "half").unwrap();
        }
        let mut staged = Staged::open_alone(root.path(), "a test").unwrap();
        staged.write("one", |w| w.write_all(b"1")).unwrap();
        staged.commit().unwrap();
        let mut left = [&other[..], &["one"]].concat();
        left.sort();
        assert_eq!(names(root.path()), left);
    }

    #[test]
    fn the_last_file_is_never_there_beside_those_of_another_run() {
        let root = tempfile::tempdir().unwrap();
        let write = |content: &[u8]| {
            let mut staged = Staged::open(root.path()).unwrap();
            for name in ["a", "b", "last"] {
                staged.write(name, |w| w.write_all(content)).unwrap();
            }
            staged.commit()
        };
        write(b"old").unwrap();
        // A folder in the place of a file cannot be replaced: the commit ends between the files.
        fs::remove_file(root.path().join("b")).unwrap();
        fs::create_dir(root.path().join("b")).unwrap();
        let message = write(b"new").unwrap_err().to_string();
        assert!(message.contains("b: "), "{message}");
        assert_eq!(names(root.path()), ["a", "b"]);
        assert_eq!(fs::read(root.path().join("a")).unwrap(), b"new");
    }

    #[test]
    fn a_file_in_the_folders_place_is_an_error_that_says_so() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("file");
        fs::write(&path, "x").unwrap();
        let message = Staged::open(&path).err().unwrap().to_string();
        assert!(message.contains("file: is a file"), "{message}");
    }
}
