//! Reads containers; trusts nothing in them.

use std::{
    collections::HashMap,
    fs::File,
    io::Read,
    path::{Path, PathBuf},
    sync::OnceLock,
};

use bytemuck::Pod;
use bytes::Bytes;
use rayon::prelude::*;
use serde::de::DeserializeOwned;

use super::{
    array::Array,
    layout::{END, Entry, FORMAT, Footer, Header, MAGIC, Name, aligned},
    map::map,
};
use crate::{Error, Result};

/// An open container. Blocks are compared with their checksums before they are handed out, each once.
pub struct Container {
    path: PathBuf,
    bytes: Bytes,
    blocks: Vec<Block>,
    by_name: HashMap<(Name, u64), usize>,
    hash: [u8; 32],
}

struct Block {
    entry: Entry,
    at: usize,
    /// Whether the payload is what the table says, once somebody has looked.
    sound: OnceLock<bool>,
}

/// What a file that is no container could be made again by.
const REMEDY: &str = "copy it again, or make it anew";

impl Container {
    /// Maps the file `path`, which was written for `purpose`, and checks all but the payloads.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Input`] if the file is foreign, for something else, newer, cut off or damaged.
    pub fn open(path: &Path, purpose: Name) -> Result<Container> {
        Container::of_bytes(path, map(path)?, purpose)
    }

    /// As [`Container::open`], of the content of a file; `path` is for messages.
    ///
    /// # Errors
    /// As of [`Container::open`].
    pub fn of_bytes(path: &Path, bytes: Bytes, purpose: Name) -> Result<Container> {
        let header = header(path, &bytes)?;
        let (footer, entries) = table(path, &bytes, &header)?;
        if header.purpose != purpose {
            let message = format!("is a {} file, but a {purpose} file is needed here", header.purpose);
            return Err(Error::input(path, "", message));
        }
        let blocks = places(&entries, footer.table).ok_or_else(|| damaged(path))?;
        let by_name: HashMap<(Name, u64), usize> =
            blocks.iter().enumerate().map(|(i, b)| ((b.entry.kind, b.entry.number), i)).collect();
        // A name that occurs twice would hide a block.
        if by_name.len() != blocks.len() {
            return Err(damaged(path));
        }
        Ok(Container { path: path.into(), bytes, blocks, by_name, hash: footer.hash })
    }

    /// What the file `path` is for, as its first bytes say, whatever its format and state; `None` if it is none of luxel's own.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn purpose(path: &Path) -> Result<Option<Name>> {
        let mut start = Vec::new();
        let read = File::open(path).and_then(|file| file.take(size_of::<Header>() as u64).read_to_end(&mut start));
        read.map_err(|e| Error::io(path, e))?;
        Ok(struct_at::<Header>(&start, 0).filter(|header| header.magic == MAGIC).map(|header| header.purpose))
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Kinds and numbers of all blocks, in the order of the file.
    pub fn names(&self) -> impl Iterator<Item = (Name, u64)> {
        self.blocks.iter().map(|b| (b.entry.kind, b.entry.number))
    }

    /// What tells this content from any other, hexadecimal: the hash of header and table, which holds those of the blocks.
    pub fn id(&self) -> String {
        blake3::Hash::from(self.hash).to_hex().to_string()
    }

    /// Numbers of the blocks of `kind`, in the order of the file.
    pub fn numbers(&self, kind: Name) -> impl Iterator<Item = u64> {
        self.names().filter(move |name| name.0 == kind).map(|name| name.1)
    }

    /// Length of block `number` of `kind` in bytes, if it is there.
    pub fn length(&self, kind: Name, number: u64) -> Option<usize> {
        let &i = self.by_name.get(&(kind, number))?;
        Some(self.blocks[i].entry.length as usize)
    }

    /// Bytes of the file.
    pub fn size(&self) -> usize {
        self.bytes.len()
    }

    /// Bytes of the blocks that nobody has looked at.
    pub fn unread(&self) -> usize {
        self.blocks.iter().filter(|b| b.sound.get().is_none()).map(|b| b.entry.length as usize).sum()
    }

    /// The payload of block `number` of `kind`: a part of the mapped file, at a multiple of 64 bytes.
    ///
    /// # Errors
    /// [`Error::Input`] naming the block if it is not there, or not what its checksum says.
    pub fn block(&self, kind: Name, number: u64) -> Result<Bytes> {
        Ok(self.block_with_hash(kind, number)?.0)
    }

    /// As [`Container::block`], and the checksum that the payload has.
    ///
    /// # Errors
    /// As of [`Container::block`].
    pub(super) fn block_with_hash(&self, kind: Name, number: u64) -> Result<(Bytes, [u8; 32])> {
        match self.by_name.get(&(kind, number)) {
            Some(&i) => Ok((self.payload(i)?, self.blocks[i].entry.hash)),
            None => Err(self.wrong(kind, number, &format!("is missing: {REMEDY}"))),
        }
    }

    /// The value that [`Writer::value`](super::Writer::value) wrote as block `number` of `kind`.
    ///
    /// # Errors
    /// [`Error::Input`] naming the block if it is not there, not what its checksum says, or holds something else.
    pub fn value<T: DeserializeOwned>(&self, kind: Name, number: u64) -> Result<T> {
        let payload = self.block(kind, number)?;
        match postcard::take_from_bytes(&payload) {
            Ok((value, [])) => Ok(value),
            Ok((_, rest)) => Err(self.wrong(kind, number, &format!("has {} bytes too many: {REMEDY}", rest.len()))),
            Err(e) => Err(self.wrong(kind, number, &format!("cannot be understood ({e}): {REMEDY}"))),
        }
    }

    /// The values that [`Writer::array`](super::Writer::array) wrote as block `number` of `kind`, where they lie in the file.
    ///
    /// # Errors
    /// [`Error::Input`] naming the block if it is not there, not what its checksum says, or no whole number of values.
    pub fn array<T: Pod>(&self, kind: Name, number: u64) -> Result<Array<T>> {
        let array = Array::of_bytes(self.block(kind, number)?);
        array.ok_or_else(|| {
            self.wrong(kind, number, &format!("is no whole number of {} bytes: {REMEDY}", size_of::<T>()))
        })
    }

    /// The value that [`Writer::json`](super::Writer::json) wrote as block `number` of `kind`.
    ///
    /// # Errors
    /// As of [`Container::value`].
    pub fn json<T: DeserializeOwned>(&self, kind: Name, number: u64) -> Result<T> {
        let payload = self.block(kind, number)?;
        let not = |e| self.wrong(kind, number, &format!("cannot be understood ({e}): {REMEDY}"));
        serde_json::from_slice(&payload).map_err(not)
    }

    /// Compares all blocks with their checksums, on all threads: a long computation should not find at its end that
    /// something is damaged.
    ///
    /// # Errors
    /// As of [`Container::block`], for the first damaged block of the file.
    pub fn verify(&self) -> Result<()> {
        let sound: Vec<bool> = (0..self.blocks.len()).into_par_iter().map(|i| self.is_sound(i)).collect();
        sound.iter().position(|sound| !sound).map_or(Ok(()), |i| self.payload(i).map(drop))
    }

    /// An [`Error::Input`] that names a block.
    pub fn wrong(&self, kind: Name, number: u64, message: &str) -> Error {
        Error::input(&self.path, format!("block {kind} {number}"), message)
    }

    fn payload(&self, i: usize) -> Result<Bytes> {
        let Block { entry, at, .. } = &self.blocks[i];
        if self.is_sound(i) {
            return Ok(self.bytes.slice(*at..at + entry.length as usize));
        }
        let message = format!("its {} bytes are not what was written: {REMEDY}", entry.length);
        Err(self.wrong(entry.kind, entry.number, &message))
    }

    fn is_sound(&self, i: usize) -> bool {
        let Block { entry, at, sound } = &self.blocks[i];
        *sound.get_or_init(|| blake3::hash(&self.bytes[*at..at + entry.length as usize]) == entry.hash)
    }
}

/// The first 64 bytes, of a format that can be read.
fn header(path: &Path, bytes: &[u8]) -> Result<Header> {
    let wrong = |message: String| Error::input(path, "", message);
    if cfg!(target_endian = "big") {
        return Err(wrong("files of luxel can be read on little-endian machines alone".into()));
    }
    let foreign = || wrong(format!("is no file of luxel's own, or its first bytes are lost ({} bytes)", bytes.len()));
    let header = struct_at::<Header>(bytes, 0).filter(|h| h.magic == MAGIC).ok_or_else(foreign)?;
    if header.format != FORMAT {
        return Err(wrong(format!(
            "has format {}, but this luxel reads format {FORMAT}: use the luxel that wrote it, or make it anew",
            header.format
        )));
    }
    Ok(header)
}

/// The last 64 bytes, and the entries of the table.
fn table(path: &Path, bytes: &[u8], header: &Header) -> Result<(Footer, Vec<Entry>)> {
    let cut = || Error::input(path, "", format!("is cut off or damaged at its end, byte {}: {REMEDY}", bytes.len()));
    let end = bytes.len().checked_sub(size_of::<Footer>()).ok_or_else(cut)?;
    let footer = struct_at::<Footer>(bytes, end).filter(|f| f.end == END).ok_or_else(cut)?;
    let begin = usize::try_from(footer.table).ok();
    let table = begin.and_then(|begin| bytes.get(begin..end)).ok_or_else(|| damaged(path))?;
    let hash = blake3::Hasher::new().update(bytemuck::bytes_of(header)).update(table).finalize();
    let whole = footer.blocks.checked_mul(size_of::<Entry>() as u64) == Some(table.len() as u64);
    if !whole || hash != footer.hash || (header.zero, header.rest, footer.zero) != (0, [0; 4], 0) {
        return Err(damaged(path));
    }
    Ok((footer, table.chunks_exact(size_of::<Entry>()).map(bytemuck::pod_read_unaligned).collect()))
}

/// Where the blocks lie: one after the other, up to the table that begins at `end`.
fn places(entries: &[Entry], end: u64) -> Option<Vec<Block>> {
    let mut at = size_of::<Header>() as u64;
    let mut blocks = Vec::with_capacity(entries.len());
    for &entry in entries {
        let begin = aligned(at)?;
        at = begin.checked_add(entry.length).filter(|&at| at <= end)?;
        blocks.push(Block { entry, at: usize::try_from(begin).ok()?, sound: OnceLock::new() });
    }
    (aligned(at) == Some(end)).then_some(blocks)
}

fn damaged(path: &Path) -> Error {
    Error::input(path, "table of blocks", format!("is damaged: {REMEDY}"))
}

fn struct_at<T: bytemuck::AnyBitPattern>(bytes: &[u8], at: usize) -> Option<T> {
    Some(bytemuck::pod_read_unaligned(bytes.get(at..at.checked_add(size_of::<T>())?)?))
}
