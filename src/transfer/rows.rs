//! A store of rows.
//!
//! A row depends on the geometry, the settings and its patch alone. Where it was cast, in which order and for which
//! lights makes no difference, so rows can be kept, shared and cast anew at will.

use rayon::prelude::*;

use super::block::{Block, BlockWriter, RowRef, View};
use crate::outlook::{Limit, Outlook};

/// Rows that have been cast, by patch.
#[derive(Clone, Debug, Default)]
pub struct Rows {
    blocks: Vec<Block>,
    /// One more than the block of the row of each patch, and its position there; [`NONE`] without one.
    place: Vec<[u32; 2]>,
}

/// Zeros, which the system gives without touching the memory: who has rows of few patches does not pay for all.
const NONE: [u32; 2] = [0; 2];

impl Rows {
    /// No rows of so many patches.
    pub fn new(patches: usize) -> Rows {
        Rows { blocks: Vec::new(), place: vec![NONE; patches] }
    }

    /// Number of patches.
    pub fn patches(&self) -> usize {
        self.place.len()
    }

    /// Which patches have a row and are not hidden.
    pub fn visible(&self) -> Vec<bool> {
        (0..self.patches() as u32).map(|i| self.get(i).is_some_and(|r| r.row.view != View::Hidden)).collect()
    }

    /// Adds rows, of patches that there are; they take the place of older ones.
    pub fn add(&mut self, block: Block) {
        let number = self.blocks.len() as u32 + 1;
        for (k, row) in (0..).zip(&block.rows) {
            self.place[row.patch as usize] = [number, k];
        }
        self.blocks.push(block);
    }

    /// The row of patch `i`.
    pub fn get(&self, i: u32) -> Option<RowRef<'_>> {
        let [number, row] = self.place[i as usize];
        self.block(number).map(|b| b.row(row as usize))
    }

    /// The row of patch `i`, if it has so many rays.
    pub fn with_rays(&self, i: u32, rays: usize) -> Option<RowRef<'_>> {
        self.get(i).filter(|r| r.row.rays() as usize == rays)
    }

    /// The rows of those patches that are `wanted`, in order, a block for each so many successive patches: the same bytes
    /// wherever, when and together with which others they were cast. Blocks that are so already are not copied.
    pub fn in_order(&self, patches: usize, wanted: impl Fn(u32) -> bool + Sync) -> Rows {
        let all: Vec<u32> = (0..self.place.len() as u32).collect();
        let blocks: Vec<Option<Block>> = all.par_chunks(patches).map(|run| self.block_of(run, &wanted)).collect();
        let mut rows = Rows::new(self.place.len());
        blocks.into_iter().flatten().for_each(|block| rows.add(block));
        rows
    }

    /// Shows all rows to `each` in order, a block for each so many successive patches: see [`Rows::in_order`]. There are as
    /// many of these blocks at a time as threads, so that the next ones find memory that has been in use.
    ///
    /// # Errors
    /// The first of `each`.
    pub fn each_in_order<E>(&self, patches: usize, mut each: impl FnMut(&Block) -> Result<(), E>) -> Result<(), E> {
        // No look at the patches before and behind those of a part of the scene.
        let there = || self.blocks.iter().flat_map(|block| &block.rows).map(|row| row.patch);
        let first = there().min().map_or(0, |first| first - first % patches as u32);
        let all: Vec<u32> = (first..there().max().map_or(0, |last| last + 1)).collect();
        for some in all.chunks(patches * rayon::current_num_threads()) {
            let blocks: Vec<Option<Block>> =
                some.par_chunks(patches).map(|run| self.block_of(run, &|_| true)).collect();
            blocks.iter().flatten().try_for_each(&mut each)?;
        }
        Ok(())
    }

    /// The rows of those patches of `run` that are `wanted`, as one block; `None` if there are none.
    fn block_of(&self, run: &[u32], wanted: &(impl Fn(u32) -> bool + Sync)) -> Option<Block> {
        let run: Vec<u32> = run.iter().copied().filter(|&i| wanted(i) && self.get(i).is_some()).collect();
        let number = self.place[*run.first()? as usize][0];
        let block = self.block(number)?;
        let is_here = |(k, &i): (u32, &u32)| self.place[i as usize] == [number, k];
        if block.rows.len() == run.len() && (0..).zip(&run).all(is_here) {
            return Some(block.clone());
        }
        let rows = || run.iter().filter_map(|&i| self.get(i));
        let mut writer = BlockWriter::with_room_for(rows());
        rows().for_each(|row| writer.copy(row));
        // Marks are of all rows or of none.
        if rows().any(|row| row.leading().is_none()) {
            writer.unmark();
        }
        Some(writer.finish())
    }

    /// The blocks, in the order in which they were added.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// Block of the row of patch `i`, and where its bytes lie in it.
    pub(super) fn place(&self, i: usize) -> Option<(u32, u32, u32)> {
        let [number, row] = self.place[i];
        let block = self.block(number)?;
        let begin = if row == 0 { 0 } else { block.rows[row as usize - 1].end };
        Some((number - 1, begin, block.rows[row as usize].end))
    }

    /// The block of a place.
    fn block(&self, number: u32) -> Option<&Block> {
        self.blocks.get((number as usize).checked_sub(1)?)
    }

    /// Bytes that it takes.
    pub fn size_in_bytes(&self) -> usize {
        self.blocks.iter().map(Block::size_in_bytes).sum::<usize>() + size_of_val(&self.place[..])
    }
}

/// Is shown every block of rows that is cast, before it is used.
pub trait RowKeeper {
    /// Is told, before the first row is cast, of the store that they come to: the rows of earlier work may be added to it.
    /// `outlook` tells what the work will take; it casts a few rows to find out.
    ///
    /// # Errors
    /// The work shall not be done.
    fn begin(&mut self, _rows: &mut Rows, _outlook: &dyn Fn() -> crate::Result<Outlook>) -> crate::Result<()> {
        Ok(())
    }

    /// How much memory the process may take, if that is limited.
    fn limit(&self) -> Option<Limit> {
        None
    }

    /// Whether rows leave the memory: then it need not hold all of them.
    fn spills(&self) -> bool {
        false
    }

    /// Writes the block down, moves its bytes elsewhere, or does nothing.
    ///
    /// # Errors
    /// The rows cannot be kept, or no more are wanted: no more are cast.
    fn keep(&mut self, block: Block) -> crate::Result<Block>;
}

/// Keeps nothing.
impl RowKeeper for () {
    fn keep(&mut self, block: Block) -> crate::Result<Block> {
        Ok(block)
    }
}

#[cfg(test)]
mod tests {
    use super::{super::Row, *};

    fn row(patch: u32, hits: u32, escaped: u32) -> Row {
        let view = if escaped > 0 { View::Outside } else { View::Within };
        Row { patch, valid: hits + escaped, escaped, view, ..Row::default() }
    }

    #[test]
    fn rows_in_order_are_the_same_however_they_came() {
        let entries = |i: u32| vec![(i + 1, 1 + i), (i + 200, 300)];
        let add = |rows: &mut Rows, patches: &[u32]| {
            let mut writer = BlockWriter::default();
            for &i in patches {
                writer.push(&entries(i), row(i, 301 + i, 0));
                writer.mark(&entries(i), &[(i + 1, 1)]);
            }
            rows.add(writer.finish());
        };
        let mut straight = Rows::new(10);
        [[0, 1, 2, 3], [4, 5, 6, 7]].iter().for_each(|patches| add(&mut straight, patches));
        let mut mixed = Rows::new(10);
        [&[7, 2][..], &[3, 1], &[9, 5], &[5, 4, 0, 6]].into_iter().for_each(|patches| add(&mut mixed, patches));
        let ordered = mixed.in_order(4, |i| i < 8);
        assert_eq!(ordered.blocks(), straight.blocks());
        assert!(ordered.get(9).is_none() && mixed.get(9).is_some());
        // What is in order is not copied.
        let again = ordered.in_order(4, |_| true);
        assert_eq!(again.blocks()[1].bytes.as_ptr(), ordered.blocks()[1].bytes.as_ptr());
        // A row without marks takes them from its block.
        let mut writer = BlockWriter::default();
        writer.push(&entries(6), row(6, 307, 0));
        mixed.add(writer.finish());
        let unmarked = mixed.in_order(4, |_| true);
        assert!(unmarked.get(5).unwrap().leading().is_none() && unmarked.get(1).unwrap().leading().is_some());
        assert!(unmarked.blocks().iter().all(|block| block.check(10 + 200).is_ok()));
    }
}
