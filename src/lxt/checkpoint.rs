//! Rows of a computation that is under way, so that it can be taken up where it was ended.
//!
//! A [log](super::log): a head that says of what the rows are, then blocks of rows. What is left of it after a kill are
//! whole rows, and rows are the same whoever casts them.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use bytes::Bytes;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{
    Identity,
    log::{self, frame, put},
    map::map,
    rows,
};
use crate::{
    BakeOptions, Error, Result, Scene,
    transfer::{Block, Rows},
};

/// First bytes of the file; the last of them is the version of the format.
const MAGIC: &[u8; 8] = b"LuxelCk\x01";
/// Bytes of rows that do not wait longer for being written.
const WAITING: usize = 64 << 20;
/// Settings that rows depend on.
const SETTINGS: [&str; 7] = ["resolution", "patches", "target_patches", "rays", "seed", "skip", "only"];

/// What rows are of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Subject {
    identity: Identity,
    settings: Value,
}

/// A file that rows are written to as they come. It is there once the first are written, until [`Checkpoint::remove`].
pub struct Checkpoint {
    path: PathBuf,
    subject: Subject,
    /// `None` until the first rows are written.
    file: Option<File>,
    waiting: Vec<(Block, bool)>,
    waiting_bytes: usize,
    written: Instant,
    every: Duration,
}

impl Checkpoint {
    /// A checkpoint at `path` of the rows of `scene` with `options`, which are written `every` so often: work that takes
    /// less writes no file at all, longer work can lose so much. No file is touched yet.
    ///
    /// # Errors
    /// Those of [`Identity::new`].
    pub fn new(path: PathBuf, scene: &Scene, options: &BakeOptions, every: Duration) -> Result<Checkpoint> {
        Checkpoint::of(path, Identity::new(scene, options)?, options, every)
    }

    /// As [`Checkpoint::new`], for a scene of which the identity is known.
    ///
    /// # Errors
    /// None in practice: settings always have names.
    pub fn of(path: PathBuf, identity: Identity, options: &BakeOptions, every: Duration) -> Result<Checkpoint> {
        let all = serde_json::to_value(options).map_err(|e| Error::Option(format!("settings without a name: {e}")))?;
        let settings = SETTINGS.iter().map(|&name| (name.to_string(), all[name].clone())).collect();
        Ok(Checkpoint {
            path,
            subject: Subject { identity, settings },
            file: None,
            waiting: Vec::new(),
            waiting_bytes: 0,
            written: Instant::now(),
            every,
        })
    }

    /// How many rows that count the file at `path` has, as far as the lengths in it tell; somebody else may be writing it.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn rows_in(path: &Path) -> Result<usize> {
        let heads = || log::heads::<{ rows::HEAD }>(&mut File::open(path)?, MAGIC.len() as u64);
        let heads = heads().map_err(|e| Error::io(path, e))?;
        // The first frame tells of what the rows are.
        Ok(heads.iter().skip(1).map(|head| rows::count(head)).sum())
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Begins anew: removes the file of earlier work, if there is one.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn discard(&mut self) -> Result<()> {
        (self.file, self.written) = (None, Instant::now());
        match fs::remove_file(&self.path) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => Err(Error::io(&self.path, e)),
            _ => Ok(()),
        }
    }

    /// Takes up earlier work, if there is any: adds its rows to `rows`, and those of other rays to `again`, and goes on
    /// behind them. How many rows there were.
    ///
    /// # Errors
    /// [`Error::Input`] for rows of another build, scene or settings, naming what differs; [`Error::Io`].
    pub fn resume(&mut self, rows: &mut Rows, again: Option<&mut Rows>) -> Result<usize> {
        self.written = Instant::now();
        let bytes = match map(&self.path) {
            Err(Error::Io { source, .. }) if source.kind() == io::ErrorKind::NotFound => return Ok(0),
            mapped => mapped?,
        };
        let Some(body) = self.check_head(&bytes)? else {
            return self.discard().map(|()| 0);
        };
        let (patches, mut stores, mut found) = (rows.patches(), [Some(rows), again], 0);
        let mut end = body;
        while let Some((payload, next)) = frame(&bytes, end) {
            // The payload is what was written, so that it fits this scene or is of a format that is not ours.
            let blocks = [false, true].map(|again| rows::decode(&payload, again, patches));
            let which = blocks[0].is_err() as usize;
            let [first, second] = blocks;
            let block = first.or(second).map_err(|what| self.wrong(&format!("a block of rows {what}")))?;
            found += block.rows.len();
            if let Some(store) = &mut stores[which] {
                store.add(block);
            }
            end = next;
        }
        let reopened = || {
            let mut file = OpenOptions::new().write(true).open(&self.path)?;
            // Nothing behind the end is in use: frames were taken up to it alone.
            file.set_len(end as u64)?;
            file.seek(SeekFrom::End(0))?;
            Ok(file)
        };
        self.file = Some(reopened().map_err(|e| Error::io(&self.path, e))?);
        Ok(found)
    }

    /// Adds rows; of other rays than those that count, if `again`. They are in the file before long.
    ///
    /// # Errors
    /// [`Error::Io`], if the disk is full.
    pub fn add(&mut self, block: &Block, again: bool) -> Result<()> {
        self.waiting_bytes += block.bytes.len() + block.marks.len();
        self.waiting.push((block.clone(), again));
        if self.waiting_bytes >= WAITING || self.written.elapsed() >= self.every { self.flush() } else { Ok(()) }
    }

    /// Writes what waits.
    ///
    /// # Errors
    /// [`Error::Io`], if the disk is full.
    pub fn flush(&mut self) -> Result<()> {
        self.written = Instant::now();
        self.waiting_bytes = 0;
        let waiting = std::mem::take(&mut self.waiting);
        if waiting.is_empty() {
            return Ok(());
        }
        self.write(&waiting).map_err(|e| Error::io(&self.path, e))
    }

    /// Removes the file: the work is done.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn remove(mut self) -> Result<()> {
        self.waiting.clear();
        self.discard()
    }

    fn write(&mut self, blocks: &[(Block, bool)]) -> io::Result<()> {
        let file = match &mut self.file {
            Some(file) => file,
            none => {
                let mut file = File::create(&self.path)?;
                file.write_all(MAGIC)?;
                put(&mut file, &[&serde_json::to_vec(&self.subject)?])?;
                none.insert(file)
            }
        };
        for (block, again) in blocks {
            put(file, &[&rows::head(block, *again)?, &block.bytes, &block.marks])?;
            block.was_read(block.bytes.len() + block.marks.len());
        }
        Ok(())
    }

    /// Where the frames of rows begin; `None` if the head itself is torn.
    fn check_head(&self, bytes: &Bytes) -> Result<Option<usize>> {
        let Some(magic) = bytes.get(..MAGIC.len()) else { return Ok(None) };
        if magic != MAGIC {
            return Err(self.wrong("is no checkpoint of this version of luxel"));
        }
        let Some((head, body)) = frame(bytes, MAGIC.len()) else { return Ok(None) };
        let there: Subject =
            serde_json::from_slice(&head).map_err(|e| self.wrong(&format!("cannot be understood ({e})")))?;
        there.identity.check_build(&self.path)?;
        if there.identity.surfaces != self.subject.identity.surfaces {
            return Err(self.wrong("is of other surfaces: the scene, or which of its sides receive light, has changed"));
        }
        let differs = |name: &&&str| there.settings[**name] != self.subject.settings[**name];
        let told = |name: &&str| {
            let [there, here] = [&there.settings[*name], &self.subject.settings[*name]];
            format!("{name} {there} there, {here} here")
        };
        let differences: Vec<String> = SETTINGS.iter().filter(differs).map(told).collect();
        if !differences.is_empty() {
            return Err(self.wrong(&format!("is of other settings: {}", differences.join("; "))));
        }
        if there.identity != self.subject.identity {
            return Err(self.wrong("is of another ray tracer: --backend has changed"));
        }
        Ok(Some(body))
    }

    fn wrong(&self, what: &str) -> Error {
        Error::input(&self.path, "", format!("the checkpoint {what}; begin anew without --resume, or undo the change"))
    }
}

/// What was cast until an error is not lost, if some of it was written already.
impl Drop for Checkpoint {
    fn drop(&mut self) {
        if self.file.is_some() {
            // There is nobody to tell; what was written before is there.
            self.flush().ok();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        selftest::invariants,
        transfer::{BlockWriter, Row, View},
    };

    fn block(patch: u32) -> Block {
        let mut writer = BlockWriter::default();
        let entries = [(0, 3), (patch + 1, 5)];
        writer.push(&entries, Row { patch, valid: 8, view: View::Within, ..Row::default() });
        writer.mark(&entries, &[(0, 1)]);
        writer.finish()
    }

    const HOUR: Duration = Duration::from_secs(3600);

    fn furnished() -> Scene {
        invariants::furnished(false).build().unwrap().0
    }

    fn checkpoint(folder: &Path, options: &BakeOptions) -> Checkpoint {
        Checkpoint::new(folder.join("checkpoint"), &furnished(), options, HOUR).unwrap()
    }

    fn resumed(checkpoint: &mut Checkpoint) -> Result<Rows> {
        let mut rows = Rows::new(100);
        checkpoint.resume(&mut rows, None)?;
        Ok(rows)
    }

    #[test]
    fn what_was_written_is_there_again_however_the_file_was_torn() {
        let folder = tempfile::tempdir().unwrap();
        let options = BakeOptions::default();
        let mut first = checkpoint(folder.path(), &options);
        let path = first.path().to_owned();
        let mut ends = Vec::new();
        for patch in 0..4 {
            first.add(&block(patch), false).unwrap();
            first.flush().unwrap();
            ends.push(fs::metadata(&path).unwrap().len() as usize);
        }
        drop(first);
        let whole = fs::read(&path).unwrap();
        for end in 0..=whole.len() {
            fs::write(&path, &whole[..end]).unwrap();
            let mut torn = checkpoint(folder.path(), &options);
            let rows = resumed(&mut torn).unwrap();
            let blocks = ends.iter().filter(|e| **e <= end).count();
            assert_eq!(rows.blocks().len(), blocks, "cut at {end}");
            assert!((0..).zip(rows.blocks()).all(|(patch, b)| *b == block(patch)));
            // What is added goes behind the whole frames.
            torn.add(&block(50), false).unwrap();
            torn.flush().unwrap();
            drop(torn);
            assert_eq!(Checkpoint::rows_in(&path).unwrap(), blocks + 1);
            let rows = resumed(&mut checkpoint(folder.path(), &options)).unwrap();
            assert_eq!(rows.blocks().len(), blocks + 1);
            assert_eq!(rows.blocks()[blocks], block(50));
        }
    }

    #[test]
    fn a_damaged_byte_ends_what_is_taken_up() {
        let folder = tempfile::tempdir().unwrap();
        let options = BakeOptions::default();
        let mut first = checkpoint(folder.path(), &options);
        let path = first.path().to_owned();
        first.add(&block(0), false).unwrap();
        first.flush().unwrap();
        let end = fs::metadata(&path).unwrap().len() as usize;
        first.add(&block(1), false).unwrap();
        first.add(&block(2), false).unwrap();
        drop(first);
        let whole = fs::read(&path).unwrap();
        let frame = (whole.len() - end) / 2;
        for at in end..end + frame {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x10;
            fs::write(&path, &damaged).unwrap();
            assert_eq!(resumed(&mut checkpoint(folder.path(), &options)).unwrap().blocks().len(), 1, "byte {at}");
        }
    }

    #[test]
    fn rows_of_other_rays_go_to_their_own_store() {
        let folder = tempfile::tempdir().unwrap();
        let mut first = checkpoint(folder.path(), &BakeOptions::default());
        first.add(&block(1), false).unwrap();
        first.add(&block(2), true).unwrap();
        first.flush().unwrap();
        let (mut rows, mut again) = (Rows::new(100), Rows::new(100));
        let found = checkpoint(folder.path(), &BakeOptions::default()).resume(&mut rows, Some(&mut again)).unwrap();
        assert_eq!(Checkpoint::rows_in(&folder.path().join("checkpoint")).unwrap(), 1);
        assert_eq!((found, rows.blocks(), again.blocks()), (2, &[block(1)][..], &[block(2)][..]));
    }

    #[test]
    fn rows_of_other_settings_and_surfaces_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let mut first = checkpoint(folder.path(), &BakeOptions::default());
        first.add(&block(1), false).unwrap();
        first.flush().unwrap();
        let other = BakeOptions { rays: 512, seed: 3, point_samples: 7, ..BakeOptions::default() };
        let message = resumed(&mut checkpoint(folder.path(), &other)).unwrap_err().to_string();
        assert!(message.contains("rays 256 there, 512 here; seed 0 there, 3 here;"), "{message}");
        // What rows do not depend on may change.
        let same = BakeOptions { point_samples: 7, estimate: false, ..BakeOptions::default() };
        assert_eq!(resumed(&mut checkpoint(folder.path(), &same)).unwrap().blocks().len(), 1);

        let mut scene = furnished();
        scene.positions[0].x += 0.01;
        let path = folder.path().join("checkpoint");
        let mut moved = Checkpoint::new(path.clone(), &scene, &BakeOptions::default(), HOUR).unwrap();
        let message = resumed(&mut moved).unwrap_err().to_string();
        assert!(message.contains("of other surfaces"), "{message}");
        fs::write(&path, "something else altogether").unwrap();
        let message = resumed(&mut checkpoint(folder.path(), &same)).unwrap_err().to_string();
        assert!(message.contains("is no checkpoint of this version"), "{message}");
    }

    #[test]
    fn work_of_a_moment_writes_no_file_and_work_that_is_done_leaves_none() {
        let folder = tempfile::tempdir().unwrap();
        let count = || fs::read_dir(folder.path()).unwrap().count();
        let mut short = checkpoint(folder.path(), &BakeOptions::default());
        short.add(&block(1), false).unwrap();
        drop(short);
        assert_eq!(count(), 0);
        let mut long = checkpoint(folder.path(), &BakeOptions::default());
        long.add(&block(1), false).unwrap();
        long.flush().unwrap();
        assert_eq!(count(), 1);
        long.remove().unwrap();
        assert_eq!(count(), 0);
    }
}
