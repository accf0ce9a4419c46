//! Rows of hits: what the rays of each patch met.

use std::sync::Arc;

use bytes::Bytes;

use super::coding::{Entries, checked_entry, push_entries};
use crate::lxt::map::Windows;

/// What the leading rays of a row say of its patch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum View {
    /// All started hidden, inside or behind objects: the patch has no row.
    #[default]
    Hidden = 0,
    /// None left the scene.
    Within = 1,
    /// Some left the scene.
    Outside = 2,
}

/// What one row of rays met.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Row {
    /// Patch.
    pub patch: u32,
    /// Rays that count.
    pub valid: u32,
    /// Of these, rays that left the scene or met the back of a one-sided sheet.
    pub escaped: u32,
    /// Rays that started hidden.
    pub hidden: u32,
    /// End of the row in the bytes of its block.
    pub end: u32,
    /// End of the row in the marks of its block.
    pub marks_end: u32,
    /// What the leading rays say.
    pub view: View,
}

impl Row {
    /// Rays that were cast for it, or would have been if the patch were not hidden.
    pub fn rays(&self) -> u32 {
        self.valid + self.hidden
    }
}

/// Rows of some patches, in any order.
///
/// An entry takes 2 bytes as a rule: the step to the next patch as a variable-length integer, the count as a byte (255
/// announces a variable-length integer). Marks have a bit for every entry, from the lowest bit of a row's first byte
/// on: whether one of the leading rays met the patch. A block has marks for all of its rows or for none.
#[derive(Clone, Debug, Default)]
pub struct Block {
    /// What each row met, in the order of their bytes.
    pub rows: Vec<Row>,
    /// Entries of the rows.
    pub bytes: Bytes,
    /// Marks of the rows; empty if none were kept.
    pub marks: Bytes,
    /// The whole of it as the file has it that it was read from, so that it can be copied to another.
    pub coded: Option<Coded>,
    /// Those that the bytes lie in, if they have left the memory.
    pub(crate) windows: Option<Arc<Windows>>,
}

/// Bytes of a file that were compared with their checksum.
#[derive(Clone, Debug)]
pub struct Coded {
    /// The bytes.
    pub payload: Bytes,
    /// Their blake3.
    pub hash: [u8; 32],
}

/// Where a block was read from makes no difference.
impl PartialEq for Block {
    fn eq(&self, other: &Block) -> bool {
        (&self.rows, &self.bytes, &self.marks) == (&other.rows, &other.bytes, &other.marks)
    }
}

impl Block {
    /// The row at this position.
    pub(super) fn row(&self, k: usize) -> RowRef<'_> {
        let row = &self.rows[k];
        let (begin, marks_begin) = if k == 0 { (0, 0) } else { (self.rows[k - 1].end, self.rows[k - 1].marks_end) };
        let bytes = &self.bytes[begin as usize..row.end as usize];
        let marks = &self.marks[marks_begin as usize..row.marks_end as usize];
        self.was_read(bytes.len() + marks.len());
        RowRef { row, bytes, marks }
    }

    /// So many of its bytes were read, or are now: if they have left the memory, they do so again before long.
    pub(crate) fn was_read(&self, bytes: usize) {
        if let Some(windows) = &self.windows {
            windows.read(bytes);
        }
    }

    /// Whether rows of so many patches can be read from it: what is wrong, if they cannot. Blocks that this program
    /// did not make itself must be asked before they are used.
    ///
    /// # Errors
    /// What is wrong.
    pub fn check(&self, patches: usize) -> std::result::Result<(), String> {
        self.check_rows(patches)?;
        let (mut end, mut marks_end) = (0, 0);
        for row in &self.rows {
            let of = |what: &str| format!("row of patch {}: {what}", row.patch);
            let mut bytes = &self.bytes[end as usize..row.end as usize];
            let (mut entries, mut hits, mut next) = (0_usize, 0_u64, 0_u64);
            while !bytes.is_empty() {
                let entry = checked_entry(&mut bytes).ok_or_else(|| of("it ends within an entry"))?;
                let patch = if entries == 0 { entry.0 } else { next + entry.0 };
                if patch >= patches as u64 || (entries > 0 && entry.0 == 0) || entry.1 == 0 {
                    return Err(of("an entry is wrong"));
                }
                (entries, hits, next) = (entries + 1, hits + entry.1, patch);
            }
            if hits != (row.valid - row.escaped) as u64 {
                return Err(of("its sums are wrong"));
            }
            let marks = &self.marks[marks_end as usize..row.marks_end as usize];
            let spare = marks.last().is_some_and(|last| entries % 8 != 0 && last >> (entries % 8) != 0);
            if !self.marks.is_empty() && (marks.len() != entries.div_ceil(8) || spare) {
                return Err(of("its marks are wrong"));
            }
            (end, marks_end) = (row.end, row.marks_end);
        }
        Ok(())
    }

    /// As [`Block::check`], without a look at the entries: for who copies rows, and asks no more of them than what
    /// [`Row`] tells.
    ///
    /// # Errors
    /// What is wrong.
    pub fn check_rows(&self, patches: usize) -> std::result::Result<(), String> {
        let (mut end, mut marks_end) = (0, 0);
        for row in &self.rows {
            let of = |what: &str| format!("row of patch {}: {what}", row.patch);
            if row.patch as usize >= patches {
                return Err(of("there is no such patch"));
            }
            let marks = if self.marks.is_empty() { marks_end..marks_end } else { marks_end..row.marks_end };
            let ends = (row.end as usize <= self.bytes.len(), row.marks_end as usize <= self.marks.len());
            if row.end < end || ends != (true, true) || marks.end != row.marks_end || row.marks_end < marks_end {
                return Err(of("its bytes lie outside of the block"));
            }
            let sound = row.escaped <= row.valid
                && row.valid as u64 + row.hidden as u64 <= 1 << 16
                && (row.view == View::Hidden) == (row.valid == 0);
            if !sound {
                return Err(of("its sums are wrong"));
            }
            (end, marks_end) = (row.end, row.marks_end);
        }
        let all = end as usize == self.bytes.len() && marks_end as usize == self.marks.len();
        if all { Ok(()) } else { Err("there are bytes that belong to no row".into()) }
    }

    /// Bytes that it takes.
    pub(super) fn size_in_bytes(&self) -> usize {
        size_of::<Block>() + self.bytes.len() + self.marks.len() + self.rows.capacity() * size_of::<Row>()
    }
}

/// A block that is being made.
#[derive(Default)]
pub struct BlockWriter {
    rows: Vec<Row>,
    bytes: Vec<u8>,
    marks: Vec<u8>,
}

impl BlockWriter {
    /// With room for copies of these rows.
    pub(super) fn with_room_for<'a>(rows: impl Iterator<Item = RowRef<'a>>) -> BlockWriter {
        let [mut count, mut bytes, mut marks] = [0; 3];
        rows.for_each(|row| (count, bytes, marks) = (count + 1, bytes + row.bytes.len(), marks + row.marks.len()));
        BlockWriter {
            rows: Vec::with_capacity(count),
            bytes: Vec::with_capacity(bytes),
            marks: Vec::with_capacity(marks),
        }
    }

    /// Adds a row with these (patch, count), sorted by patch; its ends are filled in.
    pub fn push(&mut self, entries: &[(u32, u32)], row: Row) {
        push_entries(&mut self.bytes, entries);
        self.rows.push(Row { end: self.bytes.len() as u32, marks_end: self.marks.len() as u32, ..row });
    }

    /// Marks those entries of the last row that are among `leading` too. Both are sorted by patch.
    pub fn mark(&mut self, entries: &[(u32, u32)], leading: &[(u32, u32)]) {
        let begin = self.marks.len();
        self.marks.resize(begin + entries.len().div_ceil(8), 0);
        let mut leading = leading.iter().peekable();
        for (k, entry) in entries.iter().enumerate() {
            if leading.next_if(|l| l.0 == entry.0).is_some() {
                self.marks[begin + k / 8] |= 1 << (k % 8);
            }
        }
        if let Some(row) = self.rows.last_mut() {
            row.marks_end = self.marks.len() as u32;
        }
    }

    /// Adds a copy of a row with its marks.
    pub(super) fn copy(&mut self, row: RowRef) {
        self.bytes.extend_from_slice(row.bytes);
        self.marks.extend_from_slice(row.marks);
        self.rows.push(Row { end: self.bytes.len() as u32, marks_end: self.marks.len() as u32, ..*row.row });
    }

    /// Forgets all marks.
    pub(super) fn unmark(&mut self) {
        self.marks.clear();
        self.rows.iter_mut().for_each(|row| row.marks_end = 0);
    }

    /// The block so far, in memory of its own; the writer is empty again, with room for the next.
    pub(super) fn take(&mut self) -> Block {
        let [bytes, marks] = [&self.bytes, &self.marks].map(|list| Bytes::copy_from_slice(list));
        let block = Block { rows: self.rows.clone(), bytes, marks, ..Block::default() };
        self.rows.clear();
        self.bytes.clear();
        self.marks.clear();
        block
    }

    /// The block.
    pub fn finish(mut self) -> Block {
        self.bytes.shrink_to_fit();
        self.marks.shrink_to_fit();
        Block { rows: self.rows, bytes: self.bytes.into(), marks: self.marks.into(), ..Block::default() }
    }
}

/// A row in a store.
#[derive(Clone, Copy, Debug)]
pub struct RowRef<'a> {
    /// What it met in all.
    pub row: &'a Row,
    bytes: &'a [u8],
    marks: &'a [u8],
}

impl<'a> RowRef<'a> {
    /// The hits: (patch, count), sorted by patch.
    pub fn entries(&self) -> Entries<'a> {
        Entries::new(self.bytes)
    }

    /// Patches that the leading rays met; `None` if that was not kept.
    pub fn leading(&self) -> Option<impl Iterator<Item = u32> + use<'a>> {
        let marks = self.marks;
        let kept = !marks.is_empty() || self.bytes.is_empty();
        kept.then(|| {
            let marked = move |(k, _): &(usize, (u32, u32))| marks[k / 8] >> (k % 8) & 1 == 1;
            self.entries().enumerate().filter(marked).map(|(_, (patch, _))| patch)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{super::Rows, *};

    fn row(patch: u32, hits: u32, escaped: u32) -> Row {
        let view = if escaped > 0 { View::Outside } else { View::Within };
        Row { patch, valid: hits + escaped, escaped, view, ..Row::default() }
    }

    fn block() -> Block {
        let mut writer = BlockWriter::default();
        let first = [(0, 1), (1, 254), (128, 255), (300, 256), (69_999, 40_000)];
        writer.push(&first, row(7, first.iter().map(|e| e.1).sum(), 9));
        writer.mark(&first, &[(1, 3), (69_999, 1)]);
        writer.push(&[], Row { patch: 3, hidden: 256, ..Row::default() });
        writer.mark(&[], &[]);
        let second: Vec<(u32, u32)> = (0..17).map(|k| (3 * k, k + 1)).collect();
        writer.push(&second, row(4, second.iter().map(|e| e.1).sum(), 0));
        writer.mark(&second, &[(48, 1)]);
        writer.finish()
    }

    #[test]
    fn rows_and_marks_survive_coding() {
        let block = block();
        assert_eq!(block.check(70_000), Ok(()));
        let mut rows = Rows::new(70_000);
        rows.add(block);
        let entries = |i| rows.get(i).map(|r| r.entries().collect::<Vec<_>>()).unwrap();
        assert_eq!(entries(7), [(0, 1), (1, 254), (128, 255), (300, 256), (69_999, 40_000)]);
        assert!(entries(3).is_empty());
        assert_eq!(entries(4).len(), 17);
        let leading = |i| rows.get(i).and_then(|r| r.leading()).unwrap().collect::<Vec<_>>();
        assert_eq!(leading(7), [1, 69_999]);
        assert!(leading(3).is_empty());
        assert_eq!(leading(4), [48]);
        assert!(rows.get(5).is_none() && rows.with_rays(4, 1).is_none());
    }

    #[test]
    fn what_leading_rays_met_is_unknown_without_marks() {
        let mut writer = BlockWriter::default();
        writer.push(&[(2, 5)], row(0, 5, 0));
        let mut rows = Rows::new(3);
        rows.add(writer.finish());
        assert!(rows.get(0).unwrap().leading().is_none());
    }

    #[test]
    fn wrong_bytes_are_found_or_harmless() {
        // Every bit of every byte, and every end: either the check refuses it, or all of it can be read.
        let sound = block();
        let read = |block: Block| {
            if block.check(70_000).is_ok() {
                for k in 0..block.rows.len() {
                    let row = block.row(k);
                    assert!(row.entries().all(|(patch, _)| patch < 70_000));
                    row.leading().map(Iterator::count);
                }
            }
        };
        for bit in 0..8 * sound.bytes.len() {
            let mut bytes = sound.bytes.to_vec();
            bytes[bit / 8] ^= 1 << (bit % 8);
            read(Block { bytes: bytes.into(), ..sound.clone() });
        }
        for bit in 0..8 * sound.marks.len() {
            let mut marks = sound.marks.to_vec();
            marks[bit / 8] ^= 1 << (bit % 8);
            read(Block { marks: marks.into(), ..sound.clone() });
        }
        for (k, field, bit) in (0..3).flat_map(|k| (0..6).flat_map(move |f| (0..32).map(move |b| (k, f, b)))) {
            let mut block = sound.clone();
            let Row { patch, valid, escaped, hidden, end, marks_end, .. } = &mut block.rows[k];
            *[patch, valid, escaped, hidden, end, marks_end][field] ^= 1 << bit;
            read(block);
        }
        for end in 0..sound.bytes.len() {
            let cut = Block { bytes: sound.bytes.slice(..end), ..sound.clone() };
            assert!(cut.check(70_000).is_err(), "cut at {end}");
        }
    }
}
