//! The bytes of a container that are no payload. docs/LXT.md explains them.

use std::fmt;

use bytemuck::{Pod, Zeroable};

/// Version of the format; a reader refuses every other.
pub const FORMAT: u32 = 1;

/// First bytes of every file. As PNG's they tell what the usual accidents do to a file: a cleared eighth bit, line ends
/// that were translated.
pub const MAGIC: [u8; 8] = *b"\x89LXT\r\n\x1a\n";

/// Last bytes of every file.
pub const END: [u8; 8] = *b"\x89LXTend\n";

/// Payloads begin at multiples of this, so that arrays can be used where they lie.
pub const ALIGNMENT: u64 = 64;

/// A name of at most 16 letters, filled up with zeros.
#[repr(transparent)]
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Pod, Zeroable)]
pub struct Name([u8; 16]);

impl Name {
    /// `text` has 1 to 16 bytes.
    pub const fn new(text: &str) -> Name {
        let bytes = text.as_bytes();
        assert!(!bytes.is_empty() && bytes.len() <= 16);
        let mut name = [0; 16];
        let mut i = 0;
        while i < bytes.len() {
            name[i] = bytes[i];
            i += 1;
        }
        Name(name)
    }
}

/// What of it is printable.
impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let shown = self.0.iter().take_while(|b| **b != 0);
        shown.map(|&b| if b.is_ascii_graphic() { b as char } else { '?' }).try_for_each(|c| write!(f, "{c}"))
    }
}

impl fmt::Debug for Name {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "\"{self}\"")
    }
}

/// First 64 bytes of a file.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct Header {
    pub magic: [u8; 8],
    pub format: u32,
    pub zero: u32,
    /// What the file is for.
    pub purpose: Name,
    pub rest: [u64; 4],
}

/// One block in the table. Where it lies follows from the lengths of those before it.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct Entry {
    pub kind: Name,
    pub number: u64,
    pub length: u64,
    /// blake3 of the payload.
    pub hash: [u8; 32],
}

/// Last 64 bytes of a file.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct Footer {
    /// Where the table begins.
    pub table: u64,
    /// Entries of the table.
    pub blocks: u64,
    /// blake3 of header and table.
    pub hash: [u8; 32],
    pub zero: u64,
    pub end: [u8; 8],
}

const _: () = assert!(size_of::<Header>() == 64 && size_of::<Entry>() == 64 && size_of::<Footer>() == 64);

/// The next multiple of [`ALIGNMENT`].
pub fn aligned(at: u64) -> Option<u64> {
    at.checked_next_multiple_of(ALIGNMENT)
}
