//! A log: payloads of a length and a checksum each, in the order in which they came, behind a magic number.
//!
//! A process that is killed leaves a torn frame at the end at most, which is dropped; so is all that comes after a frame that
//! a power cut has damaged.

use std::{
    fs::File,
    io::{self, Read, Seek, SeekFrom, Write},
};

use bytes::Bytes;

/// Bytes of a checksum (blake3).
const HASH: usize = 32;
/// Bytes of a frame before its payload: length and checksum.
const FRAME: usize = 8 + HASH;

/// Appends a frame in one piece: what is torn is torn at the end.
pub fn put(file: &mut File, parts: &[&[u8]]) -> io::Result<()> {
    let mut frame = vec![0; FRAME];
    parts.iter().for_each(|part| frame.extend_from_slice(part));
    let (head, payload) = frame.split_at_mut(FRAME);
    head[..8].copy_from_slice(&(payload.len() as u64).to_le_bytes());
    head[8..].copy_from_slice(blake3::hash(payload).as_bytes());
    file.write_all(&frame)
}

/// The payload of the frame at `at`, and where the next begins; `None` if it is not whole.
pub fn frame(bytes: &Bytes, at: usize) -> Option<(Bytes, usize)> {
    let length = u64::from_le_bytes(bytes.get(at..at + 8)?.try_into().ok()?);
    let (begin, hash) = (at + FRAME, bytes.get(at + 8..at + FRAME)?);
    let end = begin.checked_add(usize::try_from(length).ok()?)?;
    let payload = bytes.get(begin..end)?;
    (*blake3::hash(payload).as_bytes() == *hash).then(|| (bytes.slice(begin..end), end))
}

/// The first `N` bytes of each payload of an open log, from `at` on, as far as the lengths tell: checksums are not looked at, and
/// somebody else may be writing the file.
pub fn heads<const N: usize>(file: &mut File, mut at: u64) -> io::Result<Vec<[u8; N]>> {
    let length = file.metadata()?.len();
    let mut heads = Vec::new();
    loop {
        let (mut own, mut head) = ([0; 8], [0; N]);
        file.seek(SeekFrom::Start(at))?;
        let mut next = || {
            file.read_exact(&mut own)?;
            file.seek_relative(HASH as i64)?;
            file.read_exact(&mut head)
        };
        match next() {
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => return Ok(heads),
            read => read?,
        }
        at = at.saturating_add(FRAME as u64).saturating_add(u64::from_le_bytes(own));
        if at > length {
            return Ok(heads);
        }
        heads.push(head);
    }
}
