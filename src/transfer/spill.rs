//! Rows on a disk instead of in memory.

use std::{
    fs::File,
    io,
    path::{Path, PathBuf},
    sync::Arc,
};

use bytes::Bytes;

use super::Block;
use crate::{Error, Result, lxt::map::Windows};

/// Bytes that are mapped at a time: the system allows some ten thousand maps. It is a multiple of every page size.
const WINDOW: usize = 64 << 20;

/// A file without a name that takes the bytes of rows. They are read through maps that hold few of their pages: the system
/// keeps in its memory what it has room for. The file goes with the last row, or with the process, however that ends.
pub struct Spill {
    folder: PathBuf,
    file: File,
    /// Where the next window begins.
    next: u64,
    windows: Arc<Windows>,
    /// The last window, where it lies in the file, and how much of it is taken.
    window: Bytes,
    from: u64,
    taken: usize,
}

impl Spill {
    /// An empty file on the disk of `folder`.
    ///
    /// # Errors
    /// [`Error::Io`] with the folder's path.
    pub fn new(folder: &Path) -> Result<Spill> {
        let file = tempfile::tempfile_in(folder).map_err(|e| Error::io(folder, e))?;
        let windows = Arc::default();
        Ok(Spill { folder: folder.into(), file, next: 0, windows, window: Bytes::new(), from: 0, taken: 0 })
    }

    /// Moves the bytes of `block` to the file.
    ///
    /// # Errors
    /// [`Error::Io`] with the folder's path, if the disk is full.
    pub fn put(&mut self, block: Block) -> Result<Block> {
        let mut moved = |bytes: Bytes| self.moved(&bytes).map_err(|e| Error::io(&self.folder, e));
        let (bytes, marks) = (moved(block.bytes)?, moved(block.marks)?);
        let windows = Some(self.windows.clone());
        Ok(Block { bytes, marks, rows: block.rows, coded: None, windows })
    }

    /// Bytes on the disk.
    pub fn size_in_bytes(&self) -> u64 {
        self.from + self.taken as u64
    }

    fn moved(&mut self, bytes: &[u8]) -> io::Result<Bytes> {
        if bytes.is_empty() {
            return Ok(Bytes::new());
        }
        if bytes.len() > self.window.len() - self.taken {
            let length = bytes.len().next_multiple_of(WINDOW);
            let to = self.next + length as u64;
            // Room in the file, none on the disk yet.
            self.file.set_len(to)?;
            (self.window, self.from, self.taken) = (self.windows.open(&self.file, self.next, length)?, self.next, 0);
            self.next = to;
        }
        write_at(&self.file, bytes, self.from + self.taken as u64)?;
        let place = self.taken..self.taken + bytes.len();
        self.taken = place.end;
        Ok(self.window.slice(place))
    }
}

#[cfg(unix)]
fn write_at(file: &File, bytes: &[u8], at: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, at)
}

#[cfg(not(unix))]
fn write_at(mut file: &File, bytes: &[u8], at: u64) -> io::Result<()> {
    use io::{Seek, SeekFrom, Write};
    file.seek(SeekFrom::Start(at))?;
    file.write_all(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lxt::map::WINDOWS_RESIDENT;

    fn block(seed: u8, length: usize) -> Block {
        let bytes: Vec<u8> = (0..length).map(|k| (k as u8).wrapping_mul(31).wrapping_add(seed)).collect();
        Block { bytes: bytes.into(), marks: vec![seed; 3].into(), ..Block::default() }
    }

    #[test]
    fn what_is_moved_to_a_file_reads_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let mut spill = Spill::new(folder.path()).unwrap();
        // Among them one that no window holds, and those that fill the rest of one and begin another.
        let lengths = [0, 5, WINDOW / 2, WINDOW / 2, WINDOW + 1, 7];
        let blocks: Vec<Block> = (0..).zip(lengths).map(|(seed, length)| block(seed, length)).collect();
        let moved: Vec<Block> = blocks.iter().map(|b| spill.put(b.clone()).unwrap()).collect();
        assert!(blocks == moved);
        assert!(spill.size_in_bytes() >= lengths.iter().sum::<usize>() as u64);
        // When their pages have left the process, too.
        moved[1].was_read(WINDOWS_RESIDENT);
        assert!(blocks == moved);
        // It has no name, and outlives its owner as long as there are rows in it.
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        drop(spill);
        assert!(blocks == moved);
    }
}
