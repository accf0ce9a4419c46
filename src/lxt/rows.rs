//! Rows in a container, block by block: blocks `rows`, and `again` for those of other rays.

use std::io::{self, Write};

use bytemuck::{Pod, Zeroable};
use bytes::Bytes;
use rayon::prelude::*;

use super::{Container, Name, Writer};
use crate::{
    Result,
    transfer::{Block, Coded, Row, Rows, View},
};

/// Rows that count.
pub const ROWS: Name = Name::new("rows");
/// Rows of other rays, which tell how noisy the first are.
pub const AGAIN: Name = Name::new("again");

/// First bytes of a block: how many rows, and how many bytes of entries and of marks, come after it in this order.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Head {
    rows: u32,
    bytes: u32,
    marks: u32,
    /// 0 for rows that count, 1 for those of other rays: a file must not take one for the other.
    again: u32,
}

/// Length of the head of a block.
pub(super) const HEAD: usize = size_of::<Head>();

/// Rows that count in a block that begins so.
pub(super) fn count(head: &[u8]) -> usize {
    let head: Option<Head> = head.get(..HEAD).map(bytemuck::pod_read_unaligned);
    head.filter(|head| head.again == 0).map_or(0, |head| head.rows as usize)
}

/// A row without its entries.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Record {
    patch: u32,
    valid: u32,
    escaped: u32,
    hidden: u32,
    end: u32,
    marks_end: u32,
    view: u32,
}

/// What comes before the entries and marks of a block.
///
/// # Errors
/// The block is too long for the format.
pub(super) fn head(block: &Block, again: bool) -> io::Result<Vec<u8>> {
    let length = |n: usize| u32::try_from(n).map_err(|_| io::Error::other("a block of rows is too long"));
    let (rows, bytes, marks) = (length(block.rows.len())?, length(block.bytes.len())?, length(block.marks.len())?);
    let record = |row: &Row| {
        let Row { patch, valid, escaped, hidden, end, marks_end, view } = *row;
        Record { patch, valid, escaped, hidden, end, marks_end, view: view as u32 }
    };
    let mut out = bytemuck::bytes_of(&Head { rows, bytes, marks, again: again as u32 }).to_vec();
    block.rows.iter().for_each(|row| out.extend(bytemuck::bytes_of(&record(row))));
    Ok(out)
}

/// The block that `payload` holds, of a scene with so many patches. Entries and marks are not copied.
///
/// # Errors
/// What is wrong.
pub(super) fn decode(payload: &Bytes, again: bool, patches: usize) -> std::result::Result<Block, String> {
    let block = parts(payload, again)?;
    block.check(patches)?;
    Ok(block)
}

/// The block that `payload` holds, of which nothing is checked but the lengths.
fn parts(payload: &Bytes, again: bool) -> std::result::Result<Block, String> {
    let (head, rest) = payload.split_at_checked(size_of::<Head>()).ok_or("is too short")?;
    let head: Head = bytemuck::pod_read_unaligned(head);
    let lengths = [head.rows as u64 * size_of::<Record>() as u64, head.bytes as u64, head.marks as u64];
    if lengths.iter().sum::<u64>() != rest.len() as u64 || head.again != again as u32 {
        return Err("has another length or other rays than it should".into());
    }
    let [records, bytes, _] = lengths.map(|n| n as usize);
    let row = |record: &[u8]| {
        let Record { patch, valid, escaped, hidden, end, marks_end, view } = bytemuck::pod_read_unaligned(record);
        let view = [View::Hidden, View::Within, View::Outside].into_iter().find(|v| *v as u32 == view)?;
        Some(Row { patch, valid, escaped, hidden, end, marks_end, view })
    };
    let rows: Option<Vec<Row>> = rest[..records].chunks_exact(size_of::<Record>()).map(row).collect();
    let rows = rows.ok_or("holds a row of no known kind")?;
    let begin = size_of::<Head>() + records;
    let (bytes, marks) = (payload.slice(begin..begin + bytes), payload.slice(begin + bytes..));
    Ok(Block { rows, bytes, marks, ..Block::default() })
}

/// Whether entries that are read are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entries {
    /// They can be used.
    Checked,
    /// They can be copied to a file that is checked when it is used, and no more.
    Copied,
}

/// Writes rows as block `number` of `kind`; as they were read, if they were and nothing has changed since.
///
/// # Errors
/// Those of the output.
pub fn write<W: Write>(out: &mut Writer<W>, kind: Name, number: u64, block: &Block) -> io::Result<()> {
    let again = kind == AGAIN;
    match &block.coded {
        Some(Coded { payload, hash }) if is_again(payload) == Some(again) => out.copy(kind, number, payload, *hash),
        _ => out.block(kind, number, &[&head(block, again)?, &block.bytes, &block.marks]),
    }
}

fn is_again(payload: &[u8]) -> Option<bool> {
    Some(bytemuck::pod_read_unaligned::<Head>(payload.get(..HEAD)?).again == 1)
}

/// Writes all blocks of `rows`, numbered from 0.
///
/// # Errors
/// Those of the output.
pub fn write_all<W: Write>(out: &mut Writer<W>, kind: Name, rows: &Rows) -> io::Result<()> {
    (0..).zip(rows.blocks()).try_for_each(|(number, block)| write(out, kind, number, block))
}

/// Writes all `rows` in order, a block for each so many successive patches, numbered from 0: see [`Rows::in_order`].
///
/// # Errors
/// Those of the output.
pub fn write_in_order<W: Write>(out: &mut Writer<W>, kind: Name, rows: &Rows, patches: usize) -> io::Result<()> {
    let mut number = 0;
    rows.each_in_order(patches, |block| {
        write(out, kind, number, block)?;
        number += 1;
        Ok(())
    })
}

/// Reads all blocks of `kind`, of a scene with so many patches. Entries and marks are not copied.
///
/// # Errors
/// Those of [`Container::block`]; [`Error::Input`](crate::Error::Input) if the rows are wrong.
pub fn read_all(file: &Container, kind: Name, patches: usize, entries: Entries) -> Result<Rows> {
    let mut rows = Rows::new(patches);
    read_blocks(file, kind, patches, entries)?.into_iter().for_each(|block| rows.add(block));
    Ok(rows)
}

/// As [`read_all`], without an index.
///
/// # Errors
/// As of [`read_all`].
pub fn read_blocks(file: &Container, kind: Name, patches: usize, entries: Entries) -> Result<Vec<Block>> {
    let read = |number: u64| {
        let (payload, hash) = file.block_with_hash(kind, number)?;
        let checked = parts(&payload, kind == AGAIN).and_then(|block| match entries {
            Entries::Checked => block.check(patches).map(|()| block),
            Entries::Copied => block.check_rows(patches).map(|()| block),
        });
        let block = checked.map_err(|what| file.wrong(kind, number, &what))?;
        Ok(Block { coded: Some(Coded { payload, hash }), ..block })
    };
    let numbers: Vec<u64> = file.numbers(kind).collect();
    numbers.into_par_iter().map(read).collect()
}
