//! How the entries of rows are coded: see [`Block`](super::Block).

/// Appends these (patch, count), sorted by patch, to the `bytes` of a block.
///
/// How many bytes a step takes is a matter of chance, so there is no branch on it up to three: four bytes are written,
/// and those that are too many written over.
#[inline(always)]
pub fn push_entries(bytes: &mut Vec<u8>, entries: &[(u32, u32)]) {
    let mut end = bytes.len();
    bytes.resize(end + MOST_BYTES * entries.len(), 0);
    let mut last = 0;
    for &(patch, count) in entries {
        let step = patch - last;
        last = patch;
        if step < 1 << 21 && count < 255 {
            let (two, three) = ((step >= 1 << 7) as u32, (step >= 1 << 14) as u32);
            let low = (step & 0x7f) | two << 7 | (step & 0x3f80) << 1 | three << 15 | (step & 0x1f_c000) << 2;
            let coded = low | count << (8 * (1 + two + three));
            bytes[end..end + 4].copy_from_slice(&coded.to_le_bytes());
            end += (2 + two + three) as usize;
        } else {
            put_varint(bytes, &mut end, step);
            put(bytes, &mut end, count.min(255) as u8);
            if count >= 255 {
                put_varint(bytes, &mut end, count);
            }
        }
    }
    bytes.truncate(end);
}

/// The most bytes that an entry can take: a step and a count of five each, and a mark.
const MOST_BYTES: usize = 11;

fn put(bytes: &mut [u8], end: &mut usize, byte: u8) {
    bytes[*end] = byte;
    *end += 1;
}

fn put_varint(bytes: &mut [u8], end: &mut usize, mut x: u32) {
    while x >= 0x80 {
        put(bytes, end, x as u8 | 0x80);
        x >>= 7;
    }
    put(bytes, end, x as u8);
}

/// The next step and count of bytes that may be wrong.
pub fn checked_entry(bytes: &mut &[u8]) -> Option<(u64, u64)> {
    let varint = |bytes: &mut &[u8]| {
        let mut x = 0;
        for shift in (0..35).step_by(7) {
            let byte = *bytes.split_off_first()?;
            x |= ((byte & 0x7f) as u64) << shift;
            if byte < 0x80 {
                return (x <= u32::MAX as u64).then_some(x);
            }
        }
        None
    };
    let step = varint(bytes)?;
    match *bytes.split_off_first()? {
        255 => Some((step, varint(bytes)?)),
        count => Some((step, count as u64)),
    }
}

/// Decodes the entries of a row.
pub struct Entries<'a> {
    bytes: &'a [u8],
    patch: u32,
}

impl<'a> Entries<'a> {
    /// Of the bytes of a row.
    pub fn new(bytes: &'a [u8]) -> Entries<'a> {
        Entries { bytes, patch: 0 }
    }

    #[inline(always)]
    fn byte(&mut self) -> Option<u8> {
        let (&first, rest) = self.bytes.split_first()?;
        self.bytes = rest;
        Some(first)
    }

    #[inline(always)]
    fn varint(&mut self) -> Option<u32> {
        let first = self.byte()?;
        if first < 0x80 {
            return Some(first as u32);
        }
        let mut x = (first & 0x7f) as u32;
        let mut shift = 7;
        loop {
            let b = self.byte()?;
            x |= ((b & 0x7f) as u32) << shift;
            if b < 0x80 {
                return Some(x);
            }
            shift += 7;
        }
    }
}

impl Iterator for Entries<'_> {
    type Item = (u32, u32);

    #[inline(always)]
    fn next(&mut self) -> Option<(u32, u32)> {
        self.patch += self.varint()?;
        let count = match self.byte()? {
            255 => self.varint()?,
            count => count as u32,
        };
        Some((self.patch, count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_and_counts_of_every_length_survive_coding() {
        let steps = [7, 14, 21, 28].into_iter().flat_map(|bits| [(1 << bits) - 1, 1 << bits, (1 << bits) + 1]);
        let counts = [1, 254, 255, 256, 40_000];
        let mut patch = 0;
        let entries: Vec<(u32, u32)> = steps
            .flat_map(|step| counts.map(|count| (step, count)))
            .map(|(step, count)| {
                patch += step;
                (patch, count)
            })
            .collect();
        let mut bytes = Vec::new();
        push_entries(&mut bytes, &entries);
        assert_eq!(Entries::new(&bytes).collect::<Vec<_>>(), entries);
    }
}
