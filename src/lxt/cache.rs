//! A folder of rows from earlier bakes, each file under the hash of what its rows depend on.

use std::path::{Path, PathBuf};

use super::{
    Container, Identity, Name,
    rows::{self, AGAIN, Entries, ROWS},
    simplified, write_file,
};
use crate::{
    BakeOptions, Error, Result, Scene,
    bake::{self, Bake, Kept, Run},
    output::atomic::Staged,
};

const CACHE: Name = Name::new("cache");
const IDENTITY: Name = Name::new("identity");

/// A folder of rows from earlier bakes.
///
/// Any number of processes may use it at once: files appear whole, and of two bakes that add to one file at the same time
/// the rows of the last are there after. Files are never removed.
pub struct Cache {
    folder: PathBuf,
}

/// The place of a bake's rows.
struct Entry {
    path: PathBuf,
    identity: Identity,
}

impl Cache {
    /// Makes the folder if it is missing, and proves that files can be written in it.
    ///
    /// # Errors
    /// [`Error::Io`] with its path.
    pub fn open(folder: &Path) -> Result<Cache> {
        // No files: this leaves nothing but the folder.
        Staged::open(folder)?.commit()?;
        Ok(Cache { folder: folder.into() })
    }

    /// As [`bake_with`](crate::bake::bake_with), with the rows of earlier bakes of the same surfaces with the same
    /// settings; its own are added to these. The report tells what was there. A file that is damaged, or that cannot be
    /// written, is no more than a warning of the report.
    ///
    /// # Errors
    /// Those of [`bake_with`](crate::bake::bake_with).
    pub fn bake(&self, scene: &Scene, options: &BakeOptions, run: &mut Run) -> Result<Bake> {
        let entry = self.entry(scene, options)?;
        let mut warning = None;
        let mut kept = match entry.read(scene, options) {
            Ok(kept) => kept,
            Err(e) => {
                warning = Some(format!("the rows of the cache cannot be used, and are cast anew: {e}"));
                None
            }
        }
        .unwrap_or_default();
        kept.marked = true;
        let found = kept.rows.patches() > 0;
        let again_before = kept.again.blocks().len();
        let mut bake = bake::bake_with(scene, options, &mut kept, run)?;
        if found {
            bake.report.rows.from = Some(entry.path.display().to_string());
        }
        let cast = bake.report.rows.cast > 0;
        if cast || kept.again.blocks().len() > again_before {
            match entry.write(&bake, &kept) {
                Ok(()) => bake.report.rows.kept_in = cast.then(|| entry.path.display().to_string()),
                Err(e) => warning = Some(format!("the rows cannot be kept in the cache: {e}")),
            }
        }
        bake.report.warnings.extend(warning);
        Ok(bake)
    }

    fn entry(&self, scene: &Scene, options: &BakeOptions) -> Result<Entry> {
        let identity = Identity::new(scene, options)?;
        let key = identity.key(options)?;
        Ok(Entry { path: self.folder.join(format!("{}.lxt", &key.to_hex()[..32])), identity })
    }
}

impl Entry {
    /// What is kept; `None` if nothing is.
    fn read(&self, scene: &Scene, options: &BakeOptions) -> Result<Option<Kept>> {
        let file = match Container::open(&self.path, CACHE) {
            Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            opened => opened?,
        };
        if file.json::<Identity>(IDENTITY, 0)? != self.identity {
            return Err(file.wrong(IDENTITY, 0, "is not that of this scene and build"));
        }
        file.verify()?;
        let simplified = simplified::read(&file, scene, options)?;
        let read = |kind: Name| rows::read_all(&file, kind, simplified.patches.len(), Entries::Checked);
        let (rows, again) = (read(ROWS)?, read(AGAIN)?);
        Ok(Some(Kept { rows, again, simplified: Some(simplified), ..Kept::default() }))
    }

    fn write(&self, bake: &Bake, kept: &Kept) -> Result<()> {
        write_file(&self.path, CACHE, |out| {
            out.json(IDENTITY, 0, &self.identity)?;
            simplified::write(out, &bake.simplified, &bake.options)?;
            rows::write_all(out, ROWS, &kept.rows)?;
            rows::write_all(out, AGAIN, &kept.again)
        })
    }
}
