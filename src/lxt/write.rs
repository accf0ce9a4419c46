//! Writes containers.

use std::{
    io::{self, Write},
    path::Path,
};

use bytemuck::NoUninit;
use serde::Serialize;

use super::layout::{ALIGNMENT, END, Entry, FORMAT, Footer, Header, MAGIC, Name, aligned};
use crate::{
    Result,
    output::atomic::{Staged, place_of},
};

/// Writes a container block by block; nothing of it is kept but the table.
pub struct Writer<W: Write> {
    out: W,
    header: Header,
    at: u64,
    table: Vec<Entry>,
}

impl<W: Write> Writer<W> {
    /// Begins a container for `purpose`.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn new(mut out: W, purpose: Name) -> io::Result<Writer<W>> {
        if cfg!(target_endian = "big") {
            return Err(io::Error::other("files of luxel can be written on little-endian machines alone"));
        }
        let header = Header { magic: MAGIC, format: FORMAT, zero: 0, purpose, rest: [0; 4] };
        out.write_all(bytemuck::bytes_of(&header))?;
        Ok(Writer { out, header, at: size_of::<Header>() as u64, table: Vec::new() })
    }

    /// Adds the block `number` of `kind`; its payload is the parts one after the other. A pair of kind and number may be
    /// used once.
    ///
    /// # Errors
    /// Those of the output.
    pub fn block(&mut self, kind: Name, number: u64, parts: &[&[u8]]) -> io::Result<()> {
        self.pad()?;
        let mut hasher = blake3::Hasher::new();
        let mut length = 0;
        for part in parts {
            hasher.update(part);
            self.out.write_all(part)?;
            length += part.len() as u64;
        }
        self.at += length;
        self.table.push(Entry { kind, number, length, hash: hasher.finalize().into() });
        Ok(())
    }

    /// Adds the block `number` of `kind` with a payload that is known to have this checksum.
    ///
    /// # Errors
    /// Those of the output.
    pub(super) fn copy(&mut self, kind: Name, number: u64, payload: &[u8], hash: [u8; 32]) -> io::Result<()> {
        self.pad()?;
        self.out.write_all(payload)?;
        let length = payload.len() as u64;
        self.at += length;
        self.table.push(Entry { kind, number, length, hash });
        Ok(())
    }

    /// Adds the block `number` of `kind` with `value` in postcard's wire format.
    ///
    /// # Errors
    /// Those of the output.
    pub fn value(&mut self, kind: Name, number: u64, value: &impl Serialize) -> io::Result<()> {
        self.pad()?;
        let mut payload = Payload { out: &mut self.out, hasher: blake3::Hasher::new(), length: 0, error: None };
        let written = postcard::to_io(value, &mut payload).map(drop);
        let Payload { hasher, length, error, .. } = payload;
        // The serialiser forgets what the output said.
        error.map_or(Ok(()), Err)?;
        written.map_err(io::Error::other)?;
        self.at += length;
        self.table.push(Entry { kind, number, length, hash: hasher.finalize().into() });
        Ok(())
    }

    /// Adds the block `number` of `kind` with these values in the machine's layout.
    ///
    /// # Errors
    /// Those of the output.
    pub fn array<T: NoUninit>(&mut self, kind: Name, number: u64, values: &[T]) -> io::Result<()> {
        self.block(kind, number, &[bytemuck::cast_slice(values)])
    }

    /// Adds the block `number` of `kind` with `value` in JSON: what other versions shall be able to read.
    ///
    /// # Errors
    /// Those of the output.
    pub fn json(&mut self, kind: Name, number: u64, value: &impl Serialize) -> io::Result<()> {
        self.block(kind, number, &[&serde_json::to_vec_pretty(value)?])
    }

    /// Writes the table, and returns the output.
    ///
    /// # Errors
    /// Those of the output.
    pub fn finish(mut self) -> io::Result<W> {
        self.pad()?;
        let table: &[u8] = bytemuck::cast_slice(&self.table);
        let hash = blake3::Hasher::new().update(bytemuck::bytes_of(&self.header)).update(table).finalize().into();
        let footer = Footer { table: self.at, blocks: self.table.len() as u64, hash, zero: 0, end: END };
        self.out.write_all(table)?;
        self.out.write_all(bytemuck::bytes_of(&footer))?;
        Ok(self.out)
    }

    fn pad(&mut self) -> io::Result<()> {
        let next = aligned(self.at).ok_or_else(|| io::Error::other("the file would be too long"))?;
        self.out.write_all(&[0; ALIGNMENT as usize][..(next - self.at) as usize])?;
        self.at = next;
        Ok(())
    }
}

/// A payload on its way to the file.
struct Payload<'a, W> {
    out: &'a mut W,
    hasher: blake3::Hasher,
    length: u64,
    error: Option<io::Error>,
}

impl<W: Write> Write for Payload<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.write_all(bytes)?;
        Ok(bytes.len())
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.hasher.update(bytes);
        self.length += bytes.len() as u64;
        self.out.write_all(bytes).map_err(|e| {
            let kind = e.kind();
            self.error.get_or_insert(e);
            kind.into()
        })
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Writes the file `path` whole or not at all; its folder is made if it is missing.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) with the file's path; those of [`place_of`]. What was there before stays.
pub fn write_file(
    path: &Path,
    purpose: Name,
    fill: impl FnOnce(&mut Writer<&mut dyn Write>) -> io::Result<()>,
) -> Result<()> {
    let (folder, name) = place_of(path)?;
    let mut staged = Staged::open(folder)?;
    staged.write(name, |out| {
        let mut writer = Writer::new(out, purpose)?;
        fill(&mut writer)?;
        writer.finish().map(drop)
    })?;
    staged.commit().map(drop)
}
