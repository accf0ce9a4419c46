//! Form factors as compressed sparse rows.

use rayon::prelude::*;

/// The estimated form factors F_ij: row i holds, for each patch j that rays of i met, how many did.
///
/// F_ij = hits / valid rays, so a row sums to at most 1. An entry takes 2 bytes as a rule: the step to the next
/// column as a variable-length integer, the count as a byte (255 announces a variable-length integer).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FormFactors {
    /// Where each row begins in `bytes`; one more entry than patches.
    offsets: Vec<u64>,
    bytes: Vec<u8>,
    /// Rays of each row that count.
    valid: Vec<u32>,
    /// Rays of each row that left the scene, or met the back of a one-sided sheet; they are among the valid ones.
    escaped: Vec<u32>,
    /// Rays of each row that started hidden, inside or behind objects; they do not count.
    hidden: Vec<u32>,
    /// No ray leaves the scene: the few that slip through cracks are not counted, and rows sum to 1.
    closed: bool,
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
    pub end: usize,
}

/// Rows of some patches, in any order.
#[derive(Clone, Debug, Default)]
pub struct Block {
    pub rows: Vec<Row>,
    pub bytes: Vec<u8>,
}

impl Block {
    /// Begins a row.
    pub fn row(&mut self) -> RowWriter<'_> {
        RowWriter { block: self, last: 0 }
    }

    /// The hits of row number `row`: (patch, count), sorted by patch.
    pub fn entries(&self, row: usize) -> impl Iterator<Item = (u32, u32)> {
        let begin = if row == 0 { 0 } else { self.rows[row - 1].end };
        Entries { bytes: &self.bytes[begin..self.rows[row].end], patch: 0 }
    }
}

/// Takes the entries of one row.
pub struct RowWriter<'a> {
    block: &'a mut Block,
    last: u32,
}

impl RowWriter<'_> {
    /// Adds an entry; patches come in ascending order.
    #[inline]
    pub fn add(&mut self, patch: u32, count: u32) {
        let bytes = &mut self.block.bytes;
        push_varint(bytes, patch - self.last);
        self.last = patch;
        if count < 255 {
            bytes.push(count as u8);
        } else {
            bytes.push(255);
            push_varint(bytes, count);
        }
    }

    /// Ends the row; its `end` is filled in.
    pub fn finish(self, row: Row) {
        let end = self.block.bytes.len();
        self.block.rows.push(Row { end, ..row });
    }
}

#[inline]
fn push_varint(bytes: &mut Vec<u8>, mut x: u32) {
    while x >= 0x80 {
        bytes.push(x as u8 | 0x80);
        x >>= 7;
    }
    bytes.push(x as u8);
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
    /// Puts the rows of blocks in the order of the patches. Patches that are not `wanted` or have no row get an empty
    /// one. Whether the scene is closed is told by the rows that light has `reached`.
    pub fn of_blocks(patches: usize, blocks: Vec<Block>, wanted: &[bool], reached: &[bool]) -> FormFactors {
        let mut f = FormFactors {
            offsets: Vec::with_capacity(patches + 1),
            bytes: Vec::with_capacity(blocks.iter().map(|b| b.bytes.len()).sum()),
            valid: vec![0; patches],
            escaped: vec![0; patches],
            hidden: vec![0; patches],
            closed: false,
        };
        let mut place = vec![(0u32, 0usize, 0usize); patches];
        for (k, block) in blocks.iter().enumerate() {
            let mut begin = 0;
            for row in &block.rows {
                let i = row.patch as usize;
                if wanted[i] {
                    place[i] = (k as u32, begin, row.end);
                    (f.valid[i], f.escaped[i], f.hidden[i]) = (row.valid, row.escaped, row.hidden);
                }
                begin = row.end;
            }
        }
        f.offsets.push(0);
        for (k, begin, end) in place {
            if end > begin {
                f.bytes.extend_from_slice(&blocks[k as usize].bytes[begin..end]);
            }
            f.offsets.push(f.bytes.len() as u64);
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
            let mut row = block.row();
            hits.iter().enumerate().filter(|h| *h.1 > 0).for_each(|(j, &count)| row.add(j as u32, count));
            let valid = hits.iter().sum::<u32>() + escaped;
            row.finish(Row { patch: i as u32, valid, escaped: *escaped, hidden: 0, end: 0 });
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
        self.bytes.len() + self.offsets.len() * 8 + self.valid.len() * 12
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

    fn entries(&self, i: usize) -> Entries<'_> {
        Entries { bytes: &self.bytes[self.offsets[i] as usize..self.offsets[i + 1] as usize], patch: 0 }
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
        let mut row = block.row();
        hits.iter().for_each(|&(patch, count)| row.add(patch, count));
        row.finish(Row { patch: 1, valid, escaped, hidden: 0, end: 0 });
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
