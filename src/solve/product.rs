//! F x, again and again: the rows of the patches that take part, unpacked.

use std::{io, ops::Range};

use memmap2::MmapMut;
use rayon::prelude::*;

use crate::transfer::FormFactors;

/// The form factors between the patches that exchange light.
///
/// Coded rows take three nanoseconds an entry, most of it to find out where the next one begins, so they are unpacked once:
/// a column in 16 bits and a count in 8, about what they take coded. Patches are numbered anew, without those that
/// neither send nor receive. Rows are kept in chunks, the units of parallel work, and those by spans of 65,536 columns: the
/// values that a chunk looks up then lie in a part of x that the second-level cache holds most of.
///
/// Where rows have left the memory, or take more than [`UNPACKED_PATCH`], coded ones are read instead. Both sum up each row
/// in the order of its columns, so that their bits are the same.
pub(super) struct Product<'a, const N: usize> {
    /// The patch of every row, ascending.
    pub patches: Vec<u32>,
    /// One over the rays of each row.
    scale: Vec<f64>,
    entries: Entries<'a, N>,
    /// Rows of a chunk.
    chunk: usize,
}

enum Entries<'a, const N: usize> {
    Unpacked(Vec<Chunk>),
    /// The matrix, and room for x by patch.
    Coded(&'a FormFactors, Vec<[f64; N]>),
}

/// The rows of a chunk.
struct Chunk {
    /// Columns of all entries, from the first of their span on, 16 bits each; and hits; zero: the next of `many`. They are most
    /// of what solving takes, and maps of their own: the system has these back at once, where an allocator keeps them for the
    /// thread that unpacked them, or does not, as it happens.
    columns: MmapMut,
    counts: MmapMut,
    spans: Vec<Span>,
}

/// Entries of the rows of a chunk in one span of columns, row after row.
#[derive(Clone, Default)]
struct Span {
    /// Where they lie among those of the chunk.
    entries: Range<usize>,
    /// Hits that 8 bits do not hold.
    many: Vec<u32>,
    /// Where each row ends.
    ends: Vec<u32>,
}

/// Columns and counts of a span, while rows are unpacked.
#[derive(Clone, Default)]
struct Unpacking {
    columns: Vec<u16>,
    counts: Vec<u8>,
}

/// Rows are unpacked up to so many bytes a patch, on the average: those of many rays took so long that solving does not.
pub(crate) const UNPACKED_PATCH: usize = 1024;
/// Columns of a span: what 16 bits can name.
const SPAN: usize = 1 << 16;
/// Chunks that are aimed at, and the rows they have at least and at most.
const CHUNKS: usize = 128;
const ROWS: std::ops::RangeInclusive<usize> = 64..=16384;

impl<'a, const N: usize> Product<'a, N> {
    /// The rows of `f` that are not empty, and those that `source` has light for. `spilled`: rows have left the memory.
    pub fn new(f: &'a FormFactors, source: &[[f64; N]], spilled: bool) -> Product<'a, N> {
        let takes_part = |i: usize| f.entries(i).next().is_some() || source[i] != [0.0; N];
        let patches: Vec<u32> = (0..f.len()).into_par_iter().filter(|&i| takes_part(i)).map(|i| i as u32).collect();
        let chunk = (patches.len() / CHUNKS).clamp(*ROWS.start(), *ROWS.end());
        let scale = patches.iter().map(|&i| f.scale(i as usize)).collect();
        let unpacks = !spilled && f.size_in_bytes() <= UNPACKED_PATCH * f.len();
        // What the system has no memory for is read as it is.
        let unpacked = unpacks.then(|| unpacked(f, &patches, chunk).ok()).flatten();
        let entries = unpacked.map_or_else(|| Entries::Coded(f, vec![[0.0; N]; f.len()]), Entries::Unpacked);
        Product { patches, scale, entries, chunk }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.patches.len()
    }

    /// Zeros, one a row, and what [`Product::multiply`] needs beyond.
    pub fn vector(&self) -> Vec<[f64; N]> {
        vec![[0.0; N]; self.len().next_multiple_of(SPAN)]
    }

    /// `values` of the rows, and zeros beyond. What nobody writes takes no memory.
    pub fn vector_of(&self, values: &[[f64; N]]) -> Vec<[f64; N]> {
        let mut vector = self.vector();
        vector[..values.len()].copy_from_slice(values);
        vector
    }

    /// `values` of all patches, by row.
    pub fn rows_of(&self, values: &[[f64; N]]) -> Vec<[f64; N]> {
        self.patches.iter().map(|&i| values[i as usize]).collect()
    }

    /// `out = F x`. `x` has the length of [`Product::vector`], `out` one entry a row. The same bits for any number of threads.
    pub fn multiply(&mut self, x: &[[f64; N]], out: &mut [[f64; N]]) {
        let (chunk, scale) = (self.chunk, &self.scale);
        match &mut self.entries {
            Entries::Unpacked(chunks) => {
                let (x, _) = x.as_chunks::<SPAN>();
                let scaled = out.par_chunks_mut(chunk).zip(scale.par_chunks(chunk));
                scaled.zip(chunks).with_max_len(1).for_each(|((out, scale), chunk)| {
                    out.fill([0.0; N]);
                    chunk.add(x, out);
                    out.iter_mut().zip(scale).for_each(|(out, scale)| *out = out.map(|sum| sum * scale));
                });
            }
            Entries::Coded(f, all) => {
                self.patches.iter().zip(x).for_each(|(&i, x)| all[i as usize] = *x);
                let rows = self
                    .patches
                    .par_iter()
                    .zip(scale)
                    .zip(out)
                    .with_min_len(*ROWS.start())
                    .with_max_len(4 * ROWS.start());
                rows.for_each(|((&i, scale), out)| {
                    let mut sum = [0.0; N];
                    f.entries(i as usize).for_each(|(j, count)| add(&mut sum, count, &all[j as usize]));
                    *out = sum.map(|sum| sum * scale);
                });
            }
        }
    }
}

/// Of patches that do not take part.
const NONE: u32 = u32::MAX;

/// The rows of `patches`, so many a chunk.
fn unpacked(f: &FormFactors, patches: &[u32], chunk: usize) -> io::Result<Vec<Chunk>> {
    let mut number = vec![NONE; f.len()];
    (0..).zip(patches).for_each(|(row, &i)| number[i as usize] = row);
    let room = || vec![Unpacking::default(); patches.len().div_ceil(SPAN)];
    patches.par_chunks(chunk).map_init(room, |room, patches| unpack(f, patches, &number, room)).collect()
}

/// The rows of `patches`, with `room` for their entries.
fn unpack(f: &FormFactors, patches: &[u32], number: &[u32], room: &mut [Unpacking]) -> io::Result<Chunk> {
    for room in &mut *room {
        room.columns.clear();
        room.counts.clear();
    }
    let mut spans = vec![Span::default(); room.len()];
    for &i in patches {
        for (j, count) in f.entries(i as usize) {
            // What does not take part sends nothing.
            let column = number[j as usize];
            let at = column as usize / SPAN;
            if let (Some(room), Some(span)) = (room.get_mut(at), spans.get_mut(at)) {
                room.columns.push((column as usize % SPAN) as u16);
                let few = u8::try_from(count).unwrap_or_default();
                room.counts.push(few);
                span.many.extend((few == 0).then_some(count));
            }
        }
        spans.iter_mut().zip(&*room).for_each(|(span, room)| span.ends.push(room.columns.len() as u32));
    }
    let count: usize = room.iter().map(|room| room.columns.len()).sum();
    // There is no map of nothing.
    let mut columns = MmapMut::map_anon((2 * count).max(2))?;
    let mut counts = MmapMut::map_anon(count.max(1))?;
    let mut first = 0;
    for (span, room) in spans.iter_mut().zip(room) {
        span.entries = first..first + room.columns.len();
        first = span.entries.end;
        bytemuck::cast_slice_mut(&mut columns)[span.entries.clone()].copy_from_slice(&room.columns);
        counts[span.entries.clone()].copy_from_slice(&room.counts);
    }
    Ok(Chunk { columns, counts, spans })
}

impl Chunk {
    /// `out` += the rows times `x`, by spans.
    fn add<const N: usize>(&self, x: &[[[f64; N]; SPAN]], out: &mut [[f64; N]]) {
        let columns: &[u16] = bytemuck::cast_slice(&self.columns);
        for (span, x) in self.spans.iter().zip(x) {
            span.add(&columns[span.entries.clone()], &self.counts[span.entries.clone()], x, out);
        }
    }
}

impl Span {
    /// Adds its share of every row, of these columns and counts.
    fn add<const N: usize>(&self, columns: &[u16], counts: &[u8], x: &[[f64; N]; SPAN], out: &mut [[f64; N]]) {
        let mut many = self.many.iter();
        let mut begin = 0;
        for (out, &end) in out.iter_mut().zip(&self.ends) {
            let own = begin..end as usize;
            begin = own.end;
            let mut sum = *out;
            for (&column, &few) in columns[own.clone()].iter().zip(&counts[own]) {
                let count = if few > 0 { few as u32 } else { many.next().copied().unwrap_or_default() };
                add(&mut sum, count, &x[column as usize]);
            }
            *out = sum;
        }
    }
}

#[inline(always)]
fn add<const N: usize>(sum: &mut [f64; N], count: u32, x: &[f64; N]) {
    for c in 0..N {
        sum[c] += count as f64 * x[c];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::hash;

    /// More rows than a span has columns, some empty, and counts of one byte and of more.
    fn matrix(n: u64) -> FormFactors {
        let row = |i: u64| {
            let hits = |k: u64| if k == 0 { 250 + (i % 10) as u32 } else { 1 + (hash(&[i, k, 1]) % 9) as u32 };
            let mut row: Vec<(u32, u32)> = (0..i % 23).map(|k| ((hash(&[i, k]) % n) as u32, hits(k))).collect();
            row.sort_unstable();
            row.dedup_by_key(|e| e.0);
            (row, (i % 5) as u32)
        };
        FormFactors::of_entries(&(0..n).map(row).collect::<Vec<_>>())
    }

    #[test]
    fn unpacked_and_coded_rows_give_the_bits_of_the_matrix() {
        for n in [0, 1, 100, 150_000] {
            let f = matrix(n);
            let value = |i: u64, c| (hash(&[i, c]) >> 11) as f64;
            // Patches with an empty row send too.
            let x: Vec<[f64; 2]> = (0..n).map(|i| [value(i, 0), if i % 2 == 0 { value(i, 1) } else { 0.0 }]).collect();
            let mut expected = vec![[0.0; 2]; x.len()];
            f.multiply(&x, &mut expected);
            for spilled in [false, true] {
                let mut product = Product::new(&f, &x, spilled);
                let mut out = product.rows_of(&x);
                let padded = product.vector_of(&out);
                product.multiply(&padded, &mut out);
                assert_eq!(out, product.rows_of(&expected), "{n} patches, spilled: {spilled}");
            }
        }
    }

    #[test]
    fn what_neither_sends_nor_receives_takes_no_part() {
        let f = FormFactors::of_entries(&[(vec![(1, 3), (3, 1)], 0), (vec![], 0), (vec![], 4), (vec![], 1)]);
        let product = Product::new(&f, &[[0.0], [2.0], [0.0], [0.0]], false);
        assert_eq!(product.patches, [0, 1]);
    }
}
