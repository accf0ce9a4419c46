//! What lies in the folder of a plan, and what may not come to lie there.

use std::{
    io::ErrorKind,
    path::{Component, Path, PathBuf, absolute},
};

use super::{
    Plan, plan,
    submit::{ARRAY, LOGS, MERGE},
};
use crate::{Error, Result};

impl Plan {
    /// Proves that results at `output`, a folder or a file, would not come among the files of this plan or in the place of
    /// one of them: another folder within that of the plan is fine, and so is a file of another name.
    ///
    /// # Errors
    /// [`Error::Option`] if they would; [`Error::Io`] if the system does not say where `output` lies.
    pub fn check_output(&self, output: &Path) -> Result<()> {
        let (folder, real) = (whereabouts(self.folder())?, whereabouts(output)?);
        let Ok(inside) = real.strip_prefix(&folder) else { return Ok(()) };
        let problem = match inside.components().next() {
            None => "is the folder of the plan, and results would come among its shards",
            Some(name) if name.as_os_str().to_str().is_some_and(|name| self.is_own(name)) => {
                "has a name that the plan keeps for its own files"
            }
            Some(_) => return Ok(()),
        };
        let other = self.folder().join("result");
        Err(Error::Option(format!(
            "{}: {problem}; choose another place, such as {}",
            output.display(),
            other.display()
        )))
    }

    /// Whether files of plans, also of plans with more shards, are called `name`. Some file systems do not tell small
    /// letters from capitals.
    fn is_own(&self, name: &str) -> bool {
        let name = name.to_ascii_lowercase();
        let number = name.trim_start_matches(|c: char| !c.is_ascii_digit());
        let number = &number[..number.bytes().take_while(u8::is_ascii_digit).count()];
        let of_shard = |k| [self.shard_path(k), self.checkpoint_path(k), self.lock_path(k)];
        let is_name = |path: PathBuf| path.file_name().is_some_and(|own| own == name.as_str());
        [plan::FILE, ARRAY, MERGE, LOGS].contains(&name.as_str())
            || number.parse().is_ok_and(|k| of_shard(k).into_iter().any(is_name))
    }
}

/// Where `path` is or will be, by no links: as much of it as there is, and the rest.
fn whereabouts(path: &Path) -> Result<PathBuf> {
    let path = absolute(path).map_err(|e| Error::io(path, e))?;
    for there in path.ancestors() {
        match there.canonicalize() {
            Ok(mut place) => {
                for part in path.strip_prefix(there).unwrap_or(&path).components() {
                    match part {
                        Component::ParentDir => drop(place.pop()),
                        other => place.push(other),
                    }
                }
                return Ok(place);
            }
            Err(e) if [ErrorKind::NotFound, ErrorKind::NotADirectory].contains(&e.kind()) => {}
            Err(e) => return Err(Error::io(there, e)),
        }
    }
    Ok(path)
}
