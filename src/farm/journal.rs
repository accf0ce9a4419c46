//! Rows of a shard while it is cast: what was written down survives the process.
//!
//! A file of records, each a head and a container. A record that was not written to its end is none, nor is what comes
//! after it. The file is read, not mapped, as it grows.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use bytemuck::{Pod, Zeroable};
use bytes::Bytes;

use super::Settings;
use crate::{
    Error, Result,
    lxt::{
        Container, Name, Writer,
        rows::{self, AGAIN, ROWS},
    },
    transfer::{Block, RowKeeper, Rows},
};

const JOURNAL: Name = Name::new("journal");
const SETTINGS: Name = Name::new("settings");
const MAGIC: [u8; 8] = *b"\x89LXTjnl\n";

/// From the beginning to the first record, and between two records at last. In between the times double, so that what a
/// kill costs is a few seconds, and half of the work at most.
const FIRST: Duration = Duration::from_millis(250);
const LAST: Duration = Duration::from_secs(8);

/// Before the container of a record.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Head {
    magic: [u8; 8],
    /// Bytes of the container.
    length: u64,
    /// Rows that count in this record and all before it.
    rows: u64,
    zero: u64,
}

/// A journal that is being written: shows it the rows of [`ROWS`], and then those of [`AGAIN`].
pub struct Journal<'a> {
    path: PathBuf,
    file: File,
    settings: &'a Settings,
    /// Of which kind the blocks are that come.
    pub kind: Name,
    rows: u64,
    pending: Vec<Block>,
    written: Instant,
    wait: Duration,
}

impl<'a> Journal<'a> {
    /// Opens the journal at `path` to go on with it, and returns the rows in it, and those of other rays. What does not fit
    /// `settings` or the number of patches is forgotten.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn open(path: PathBuf, settings: &'a Settings, patches: usize) -> Result<(Journal<'a>, Rows, Rows)> {
        let failed = |e| Error::io(&path, e);
        let bytes: Bytes = match fs::read(&path) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => Bytes::new(),
            read => read.map_err(failed)?.into(),
        };
        let (mut rows, mut again) = (Rows::new(patches), Rows::new(patches));
        let (mut end, mut count) = (0, 0);
        while let Some((next, head)) = head_at(&bytes, end) {
            let container = bytes.slice(end + size_of::<Head>()..next);
            let Ok([own, other]) = record(&path, container, settings, patches) else { break };
            own.into_iter().for_each(|block| rows.add(block));
            other.into_iter().for_each(|block| again.add(block));
            (end, count) = (next, head.rows);
        }
        let mut file = OpenOptions::new().write(true).create(true).truncate(false).open(&path).map_err(failed)?;
        file.set_len(end as u64).and_then(|()| file.seek(SeekFrom::End(0))).map_err(failed)?;
        let (kind, pending) = (ROWS, Vec::new());
        let journal =
            Journal { path, file, settings, kind, rows: count, pending, written: Instant::now(), wait: FIRST };
        Ok((journal, rows, again))
    }

    /// Rows that count in the journal at `path`.
    pub fn rows_in(path: &Path) -> Option<u64> {
        let mut file = File::open(path).ok()?;
        let length = file.metadata().ok()?.len();
        let (mut rows, mut at) = (0, 0);
        loop {
            let mut bytes = [0; size_of::<Head>()];
            file.seek(SeekFrom::Start(at)).ok()?;
            if file.read_exact(&mut bytes).is_err() {
                return Some(rows);
            }
            let head: Head = bytemuck::cast(bytes);
            at = at.saturating_add(size_of::<Head>() as u64).saturating_add(head.length);
            if head.magic != MAGIC || at > length {
                return Some(rows);
            }
            rows = head.rows;
        }
    }

    /// Writes down what has come since the last time, and has it on the disk.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn flush(&mut self) -> Result<()> {
        let blocks = std::mem::take(&mut self.pending);
        self.written = Instant::now();
        if blocks.is_empty() {
            return Ok(());
        }
        if self.kind == ROWS {
            self.rows += blocks.iter().map(|block| block.rows.len() as u64).sum::<u64>();
        }
        let mut write = || {
            let mut writer = Writer::new(Vec::new(), JOURNAL)?;
            writer.json(SETTINGS, 0, self.settings)?;
            (0..).zip(&blocks).try_for_each(|(number, block)| rows::write(&mut writer, self.kind, number, block))?;
            let container = writer.finish()?;
            let head = Head { magic: MAGIC, length: container.len() as u64, rows: self.rows, zero: 0 };
            self.file.write_all(bytemuck::bytes_of(&head))?;
            self.file.write_all(&container)?;
            self.file.sync_data()
        };
        write().map_err(|e| Error::io(&self.path, e))
    }

    /// Removes the journal.
    pub fn remove(self) {
        drop(self.file);
        fs::remove_file(&self.path).ok();
    }
}

impl RowKeeper for Journal<'_> {
    fn keep(&mut self, block: Block) -> Result<Block> {
        self.pending.push(block.clone());
        if self.written.elapsed() >= self.wait {
            self.flush()?;
            self.wait = (2 * self.wait).min(LAST);
        }
        Ok(block)
    }
}

/// The head at `at`, and where its record ends, if that is in `bytes`.
fn head_at(bytes: &[u8], at: usize) -> Option<(usize, Head)> {
    let begin = at + size_of::<Head>();
    let head: Head = bytemuck::pod_read_unaligned(bytes.get(at..begin)?);
    let end = begin.checked_add(usize::try_from(head.length).ok()?)?;
    (head.magic == MAGIC && end <= bytes.len()).then_some((end, head))
}

/// The blocks of a record: rows that count, rows of other rays.
fn record(path: &Path, bytes: Bytes, settings: &Settings, patches: usize) -> Result<[Vec<Block>; 2]> {
    let file = Container::of_bytes(path, bytes, JOURNAL)?;
    if file.json::<Settings>(SETTINGS, 0)? != *settings {
        return Err(file.wrong(SETTINGS, 0, "is of another shard"));
    }
    let blocks = |kind: Name| -> Result<Vec<Block>> {
        file.numbers(kind).map(|number| rows::read(&file, kind, number, patches)).collect()
    };
    Ok([blocks(ROWS)?, blocks(AGAIN)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::{BlockWriter, Row, View};

    fn block(patch: u32) -> Block {
        let mut writer = BlockWriter::default();
        writer.push(&[(patch + 1, 3)], Row { patch, valid: 4, escaped: 1, view: View::Outside, ..Row::default() });
        writer.finish()
    }

    /// A journal of rows 0 to 3, two a record, and another row 0.
    fn written(path: &Path, settings: &Settings) {
        let (mut journal, ..) = Journal::open(path.into(), settings, 10).unwrap();
        for pair in [[0, 1], [2, 3]] {
            pair.iter().for_each(|&i| drop(journal.keep(block(i)).unwrap()));
            journal.flush().unwrap();
        }
        journal.kind = AGAIN;
        journal.keep(block(0)).unwrap();
        journal.flush().unwrap();
    }

    fn rows_of(path: &Path, settings: &Settings) -> (Vec<u32>, Vec<u32>) {
        let (_, rows, again) = Journal::open(path.into(), settings, 10).unwrap();
        let of = |rows: &Rows| (0..10).filter(|&i| rows.get(i).is_some()).collect();
        (of(&rows), of(&again))
    }

    #[test]
    fn what_was_written_down_is_there_wherever_the_end_is_torn_off() {
        let folder = tempfile::tempdir().unwrap();
        let (path, settings) = (folder.path().join("journal"), Settings::default());
        written(&path, &settings);
        assert_eq!(rows_of(&path, &settings), (vec![0, 1, 2, 3], vec![0]));
        assert_eq!(Journal::rows_in(&path), Some(4));
        let whole = fs::read(&path).unwrap();
        let ends: Vec<usize> = std::iter::successors(Some(0), |&at| head_at(&whole, at).map(|h| h.0)).collect();
        assert_eq!(ends.last(), Some(&whole.len()));
        for length in (0..whole.len()).step_by(7).chain([whole.len() - 1]) {
            fs::write(&path, &whole[..length]).unwrap();
            let records = ends.iter().filter(|&&end| end <= length).count() - 1;
            let rows = (0..2 * records.min(2) as u32).collect::<Vec<u32>>();
            assert_eq!(Journal::rows_in(&path), Some(rows.len() as u64));
            assert_eq!(rows_of(&path, &settings), (rows, vec![]), "{length}");
            // What cannot be used is gone, so that what comes next is found.
            assert_eq!(fs::metadata(&path).unwrap().len(), ends[records] as u64);
        }
    }

    #[test]
    fn changed_bytes_and_other_settings_end_what_is_believed() {
        let folder = tempfile::tempdir().unwrap();
        let (path, settings) = (folder.path().join("journal"), Settings::default());
        written(&path, &settings);
        let mut bytes = fs::read(&path).unwrap();
        let second = head_at(&bytes, 0).unwrap().0;
        // In the settings of the second record.
        bytes[second + size_of::<Head>() + 70] ^= 1;
        fs::write(&path, &bytes).unwrap();
        assert_eq!(rows_of(&path, &settings), (vec![0, 1], vec![]));
        let other = Settings { surfaces: "others".into(), ..Settings::default() };
        assert_eq!(rows_of(&path, &other), (vec![], vec![]));
    }
}
