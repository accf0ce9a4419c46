//! Form factors as compressed sparse rows.

use std::sync::Arc;

use bytes::Bytes;
use rayon::prelude::*;

#[cfg(test)]
use super::{BlockWriter, Row};
use super::{RowRef, Rows, coding::Entries};
use crate::lxt::map::Windows;

/// The estimated form factors F_ij: row i holds, for each patch j that rays of i met, how many did.
///
/// F_ij = hits / valid rays, so a row sums to at most 1. Entries are coded as in [`Block`](super::Block).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FormFactors {
    /// Where each row lies.
    places: Vec<Place>,
    /// The bytes of rows that were cast together, shared with the store that they come from.
    blocks: Vec<Bytes>,
    /// Those that they lie in, if they have left the memory.
    windows: Option<Arc<Windows>>,
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

impl FormFactors {
    /// The matrix of those `rows` that are `wanted`. The other patches, and those without a row, get an empty one. Whether
    /// the scene is closed is told by the rows that light has `reached`.
    pub fn of_rows(rows: &Rows, wanted: &[bool], reached: &[bool]) -> FormFactors {
        let patches = rows.patches();
        let mut f = FormFactors {
            places: vec![Place::default(); patches],
            blocks: rows.blocks().iter().map(|block| block.bytes.clone()).collect(),
            windows: rows.blocks().iter().find_map(|block| block.windows.clone()),
            valid: vec![0; patches],
            escaped: vec![0; patches],
            hidden: vec![0; patches],
            closed: false,
        };
        for i in (0..patches).filter(|&i| wanted[i]) {
            if let (Some((block, begin, end)), Some(RowRef { row, .. })) = (rows.place(i), rows.get(i as u32)) {
                f.places[i] = Place { block, begin, end };
                (f.valid[i], f.escaped[i], f.hidden[i]) = (row.valid, row.escaped, row.hidden);
            }
        }
        let sum = |v: &[u32]| v.iter().zip(reached).filter(|r| *r.1).map(|r| *r.0 as u64).sum::<u64>();
        f.closed = sum(&f.escaped) as f64 <= CLOSED * sum(&f.valid) as f64;
        f
    }

    /// The matrix of these hits and escaping rays, row by row.
    #[cfg(test)]
    pub(crate) fn of_hits(rows: &[(Vec<u32>, u32)]) -> FormFactors {
        let entries = |hits: &[u32]| (0..).zip(hits.iter().copied()).filter(|e| e.1 > 0).collect();
        Self::of_entries(&rows.iter().map(|(hits, escaped)| (entries(hits), *escaped)).collect::<Vec<_>>())
    }

    /// The matrix of rows of (patch, hits), sorted by patch, and escaping rays.
    #[cfg(test)]
    pub(crate) fn of_entries(rows: &[(Vec<(u32, u32)>, u32)]) -> FormFactors {
        let mut block = BlockWriter::default();
        for (i, (entries, escaped)) in rows.iter().enumerate() {
            let valid = entries.iter().map(|e| e.1).sum::<u32>() + escaped;
            block.push(entries, Row { patch: i as u32, valid, escaped: *escaped, ..Row::default() });
        }
        let all = vec![true; rows.len()];
        let mut store = Rows::new(rows.len());
        store.add(block.finish());
        FormFactors::of_rows(&store, &all, &all)
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

    /// Rays of all rows.
    pub fn all_rays(&self) -> u64 {
        self.valid.iter().chain(&self.hidden).map(|&n| n as u64).sum()
    }

    /// Bytes that hold the matrix.
    pub fn size_in_bytes(&self) -> usize {
        let bytes: usize = self.blocks.iter().map(|b| b.len() + size_of::<Bytes>()).sum();
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
        // One at a time, so that no thread waits long for the last.
        out.par_chunks_mut(256).enumerate().with_max_len(1).for_each(|(chunk, out)| {
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
        let bytes = &block[place.begin as usize..place.end as usize];
        if let Some(windows) = &self.windows {
            windows.read(bytes.len());
        }
        bytes
    }

    /// What the rays of row `i` met: (patch, hits), sorted by patch.
    pub(crate) fn entries(&self, i: usize) -> Entries<'_> {
        Entries::new(self.bytes(i))
    }

    /// What a hit of row `i` counts.
    pub(crate) fn scale(&self, i: usize) -> f64 {
        let rays = if self.closed { self.valid[i] - self.escaped[i] } else { self.valid[i] };
        1.0 / rays.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one_row(hits: &[(u32, u32)], escaped: u32) -> FormFactors {
        let valid = hits.iter().map(|h| h.1).sum::<u32>() + escaped;
        let mut block = BlockWriter::default();
        block.push(hits, Row { patch: 1, valid, escaped, ..Row::default() });
        let mut rows = Rows::new(70_000);
        rows.add(block.finish());
        FormFactors::of_rows(&rows, &[true; 70_000], &[true; 70_000])
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
