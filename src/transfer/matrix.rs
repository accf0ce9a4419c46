//! Form factors as compressed sparse rows.

use rayon::prelude::*;

/// The estimated form factors F_ij: row i holds, for each patch j that rays of i met, how many did.
///
/// F_ij = hits / valid rays, so a row sums to at most 1. An entry takes 2 bytes as a rule: the step to the next
/// column as a variable-length integer, the count as a byte (255 announces a variable-length integer).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FormFactors {
    /// Where each row lies.
    places: Vec<Place>,
    /// The bytes of rows that were estimated together, as they came: there is no second copy.
    blocks: Vec<Vec<u8>>,
    /// Rays of each row that count.
    valid: Vec<u32>,
    /// Rays of each row that left the scene, or met the back of a one-sided sheet; they are among the valid ones.
    escaped: Vec<u32>,
    /// Rays of each row that started hidden, inside or behind objects; they do not count.
    hidden: Vec<u32>,
    /// No ray leaves the scene: the few that slip through cracks are not counted, and rows sum to 1.
    closed: bool,
}

/// Bytes of a row in its block.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Place {
    block: u32,
    begin: u32,
    end: u32,
}

/// Share of escaping rays below which a scene is closed: rays slip through the edge between two triangles about
/// once in a million.
const CLOSED: f64 = 2e-5;

/// What one row of rays met.
#[derive(Clone, Copy, Debug, Default)]
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
}

/// Rows of some patches, in any order.
#[derive(Clone, Debug, Default)]
pub struct Block {
    pub rows: Vec<Row>,
    pub bytes: Vec<u8>,
}

impl Block {
    /// Adds a row with these (patch, count), sorted by patch; `row.end` is filled in.
    ///
    /// Whether a step takes one byte or two is a matter of chance, so there is no branch on it: four bytes are written,
    /// and those that are too many written over.
    pub fn push(&mut self, entries: &[(u32, u32)], row: Row) {
        let mut end = self.bytes.len();
        self.bytes.resize(end + MOST_BYTES * entries.len(), 0);
        let mut last = 0;
        for &(patch, count) in entries {
            let step = patch - last;
            last = patch;
            if step < 1 << 14 && count < 255 {
                let two = (step >= 0x80) as u32;
                let coded = (step & 0x7f) | two << 7 | (step >> 7) << 8 | count << (8 + 8 * two);
                self.bytes[end..end + 4].copy_from_slice(&coded.to_le_bytes());
                end += 2 + two as usize;
            } else {
                put_varint(&mut self.bytes, &mut end, step);
                put(&mut self.bytes, &mut end, count.min(255) as u8);
                if count >= 255 {
                    put_varint(&mut self.bytes, &mut end, count);
                }
            }
        }
        self.bytes.truncate(end);
        self.rows.push(Row { end: end as u32, ..row });
    }

    /// The hits of row number `row`: (patch, count), sorted by patch.
    pub fn entries(&self, row: usize) -> impl Iterator<Item = (u32, u32)> {
        let begin = if row == 0 { 0 } else { self.rows[row - 1].end };
        Entries { bytes: &self.bytes[begin as usize..self.rows[row].end as usize], patch: 0 }
    }
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

/// Decodes the entries of a row.
struct Entries<'a> {
    bytes: &'a [u8],
    patch: u32,
}

impl Entries<'_> {
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

impl FormFactors {
    /// The matrix of the rows in `blocks`. Patches that are not `wanted` or have no row get an empty one. Whether the
    /// scene is closed is told by the rows that light has `reached`.
    pub fn of_blocks(patches: usize, blocks: Vec<Block>, wanted: &[bool], reached: &[bool]) -> FormFactors {
        let mut f = FormFactors {
            places: vec![Place::default(); patches],
            blocks: Vec::with_capacity(blocks.len()),
            valid: vec![0; patches],
            escaped: vec![0; patches],
            hidden: vec![0; patches],
            closed: false,
        };
        for (block, Block { rows, bytes }) in (0..).zip(blocks) {
            let mut begin = 0;
            for row in rows {
                let i = row.patch as usize;
                if wanted[i] {
                    f.places[i] = Place { block, begin, end: row.end };
                    (f.valid[i], f.escaped[i], f.hidden[i]) = (row.valid, row.escaped, row.hidden);
                }
                begin = row.end;
            }
            f.blocks.push(bytes);
        }
        let sum = |v: &[u32]| v.iter().zip(reached).filter(|r| *r.1).map(|r| *r.0 as u64).sum::<u64>();
        f.closed = sum(&f.escaped) as f64 <= CLOSED * sum(&f.valid) as f64;
        f
    }

    /// The matrix of these hits and escaping rays, row by row.
    #[cfg(test)]
    pub(crate) fn of_hits(rows: &[(Vec<u32>, u32)]) -> FormFactors {
        let mut block = Block::default();
        for (i, (hits, escaped)) in rows.iter().enumerate() {
            let entries: Vec<(u32, u32)> = (0..).zip(hits.iter().copied()).filter(|e| e.1 > 0).collect();
            let valid = hits.iter().sum::<u32>() + escaped;
            block.push(&entries, Row { patch: i as u32, valid, escaped: *escaped, hidden: 0, end: 0 });
        }
        let all = vec![true; rows.len()];
        FormFactors::of_blocks(rows.len(), vec![block], &all, &all)
    }

    /// Number of patches.
    pub fn len(&self) -> usize {
        self.valid.len()
    }

    /// Whether there are no patches.
    pub fn is_empty(&self) -> bool {
        self.valid.is_empty()
    }

    /// Whether no light leaves the scene; rows then sum to 1.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Bytes that hold the matrix.
    pub fn size_in_bytes(&self) -> usize {
        let bytes: usize = self.blocks.iter().map(|b| b.capacity() + size_of::<Vec<u8>>()).sum();
        bytes + self.len() * (size_of::<Place>() + 12)
    }

    /// The nonzero form factors of row `i`: (j, F_ij), j ascending.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> {
        let scale = self.scale(i);
        self.entries(i).map(move |(j, count)| (j as usize, count as f64 * scale))
    }

    /// Number of nonzero form factors.
    pub fn nonzeros(&self) -> usize {
        (0..self.len()).into_par_iter().map(|i| self.entries(i).count()).sum()
    }

    /// Share of the power of `i` that leaves the scene.
    pub fn escape(&self, i: usize) -> f64 {
        if self.closed { 0.0 } else { self.escaped[i] as f64 / self.valid[i].max(1) as f64 }
    }

    /// Share of the rays of `i` that hit something, before a closed scene's rows are normalised.
    pub fn raw_row_sum(&self, i: usize) -> f64 {
        (self.valid[i] - self.escaped[i]) as f64 / self.valid[i].max(1) as f64
    }

    /// Rays of row `i` that count, and how many of them left the scene, through cracks too.
    pub fn rays(&self, i: usize) -> (u32, u32) {
        (self.valid[i], self.escaped[i])
    }

    /// Whether row `i` was estimated and has a ray that counts.
    pub fn has_row(&self, i: usize) -> bool {
        self.valid[i] > 0
    }

    /// Share of the surface of `i` that lies hidden inside or behind objects.
    pub fn hidden(&self, i: usize) -> f64 {
        self.hidden[i] as f64 / (self.hidden[i] + self.valid[i]).max(1) as f64
    }

    /// `out_i = sum_j F_ij x_j`, N channels at once. Sums run in the order of j: the same bits for any number of
    /// threads.
    pub fn multiply<const N: usize>(&self, x: &[[f64; N]], out: &mut [[f64; N]]) {
        out.par_chunks_mut(256).enumerate().for_each(|(chunk, out)| {
            for (k, out) in out.iter_mut().enumerate() {
                let i = chunk * 256 + k;
                let mut sum = [0.0; N];
                for (j, count) in self.entries(i) {
                    let (x, count) = (&x[j as usize], count as f64);
                    for c in 0..N {
                        sum[c] += count * x[c];
                    }
                }
                *out = sum.map(|s| s * self.scale(i));
            }
        });
    }

    fn bytes(&self, i: usize) -> &[u8] {
        let place = self.places[i];
        // An empty row may come before there is any block.
        let block = self.blocks.get(place.block as usize).map_or(&[][..], |b| b);
        &block[place.begin as usize..place.end as usize]
    }

    fn entries(&self, i: usize) -> Entries<'_> {
        Entries { bytes: self.bytes(i), patch: 0 }
    }

    fn scale(&self, i: usize) -> f64 {
        let rays = if self.closed { self.valid[i] - self.escaped[i] } else { self.valid[i] };
        1.0 / rays.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one_row(hits: &[(u32, u32)], escaped: u32) -> FormFactors {
        let valid = hits.iter().map(|h| h.1).sum::<u32>() + escaped;
        let mut block = Block::default();
        block.push(hits, Row { patch: 1, valid, escaped, hidden: 0, end: 0 });
        FormFactors::of_blocks(70_000, vec![block], &[true; 70_000], &[true; 70_000])
    }

    #[test]
    fn rows_survive_coding() {
        let hits = [(0, 1), (1, 254), (128, 255), (300, 256), (69_999, 40_000)];
        let f = one_row(&hits, 1000);
        let valid = 1 + 254 + 255 + 256 + 40_000 + 1000;
        let row: Vec<_> = f.row(1).collect();
        assert_eq!(row, hits.map(|(j, n)| (j as usize, n as f64 * (1.0 / valid as f64))));
        assert_eq!(f.row(0).count(), 0);
        assert_eq!(f.nonzeros(), 5);
        assert!(!f.is_closed());
    }

    #[test]
    fn rows_of_a_closed_scene_sum_to_one() {
        let f = one_row(&[(3, 10), (5, 60_000)], 1);
        assert!(f.is_closed());
        assert!((f.row(1).map(|e| e.1).sum::<f64>() - 1.0).abs() < 1e-15);
    }
}
