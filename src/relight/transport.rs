//! Form factors unpacked for many fast products.

use glam::Vec4;
use rayon::prelude::*;

use crate::transfer::FormFactors;

/// The rows of the patches that exchange light, unpacked: E = F x at a third of a nanosecond a form factor and core, where
/// coded rows in f64 take three.
///
/// Most hits of a row are the only one on their patch, so a row is a list of places in x to add up, and a hit on a patch
/// that was met before stands there again. Patches are numbered anew, without those that exchange nothing, so that x stays
/// in the second-level cache.
pub(super) struct Transport {
    /// The patch of every row.
    pub patches: Vec<u32>,
    columns: Columns,
    /// Where the columns of each row begin; one more entry than rows.
    start: Vec<usize>,
    /// What rays of a row met more than [`REPEATS`] times: column and number of hits; and where those of each row begin.
    often: Vec<(u32, f32)>,
    often_start: Vec<u32>,
    /// One over the rays of each row.
    scale: Vec<f32>,
}

/// Columns stand in their list up to so many times.
const REPEATS: u32 = 4;
/// Rows of a unit of parallel work.
const CHUNK: usize = 128;
/// Numbers of 16 bits.
const NARROW: usize = 1 << 16;

/// Columns in 16 bits where these are enough: half the memory to read, and no index is out of range.
enum Columns {
    Narrow(Vec<u16>),
    Wide(Vec<u32>),
}

impl Transport {
    /// Unpacks the rows of all patches that meet something.
    pub fn new(f: &FormFactors) -> Transport {
        let patches: Vec<u32> = (0..f.len() as u32).filter(|&i| f.row(i as usize).next().is_some()).collect();
        let mut transport = Transport {
            columns: Columns::Wide(Vec::new()),
            start: vec![0],
            often: Vec::new(),
            often_start: vec![0],
            scale: Vec::with_capacity(patches.len()),
            patches,
        };
        let (places, none) = (transport.places(f.len()), transport.len() as u32);
        let mut columns: Vec<u32> = Vec::new();
        for &i in &transport.patches {
            let (valid, escaped) = f.rays(i as usize);
            let rays = if f.is_closed() { valid - escaped } else { valid };
            for (j, share) in f.row(i as usize) {
                let hits = (share * rays as f64).round() as u32;
                // What has no row sends nothing.
                match places[j] {
                    k if k == none => {}
                    k if hits > REPEATS => transport.often.push((k, hits as f32)),
                    k => columns.extend(std::iter::repeat_n(k, hits as usize)),
                }
            }
            transport.start.push(columns.len());
            transport.often_start.push(transport.often.len() as u32);
            transport.scale.push(1.0 / rays.max(1) as f32);
        }
        transport.columns = if transport.patches.len() <= NARROW {
            Columns::Narrow(columns.iter().map(|&c| c as u16).collect())
        } else {
            Columns::Wide(columns)
        };
        transport
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.patches.len()
    }

    /// The row of each of `patches` patches; one past the last row for those without.
    pub fn places(&self, patches: usize) -> Vec<u32> {
        let mut places = vec![self.len() as u32; patches];
        (0..).zip(&self.patches).for_each(|(row, &i)| places[i as usize] = row);
        places
    }

    /// A value for each patch that exchanges light, zero: what [`Transport::product`] takes.
    pub fn vector(&self) -> Vec<Vec4> {
        vec![Vec4::ZERO; self.len().max(NARROW)]
    }

    /// F x of the rows from `first` on, as many as `out` has room for. Sums run in one order: the same bits on any number of
    /// threads. `x` has the length of [`Transport::vector`].
    pub fn product(&self, x: &[Vec4], first: usize, out: &mut [Vec4]) {
        match (&self.columns, x.first_chunk::<NARROW>()) {
            (Columns::Narrow(columns), Some(x)) => self.rows(columns, |c| x[c as usize], first, out),
            (Columns::Narrow(columns), None) => self.rows(columns, |c| x[c as usize], first, out),
            (Columns::Wide(columns), _) => self.rows(columns, |c| x[c as usize], first, out),
        }
    }

    fn rows<C: Copy + Sync>(&self, columns: &[C], x: impl Fn(C) -> Vec4 + Sync, first: usize, out: &mut [Vec4])
    where
        C: TryFrom<u32>,
    {
        out.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, out)| {
            for (k, out) in out.iter_mut().enumerate() {
                let i = first + chunk * CHUNK + k;
                let (fours, rest) = columns[self.start[i]..self.start[i + 1]].as_chunks::<4>();
                // Four sums, so that none waits for the one before.
                let mut sums = [Vec4::ZERO; 4];
                for four in fours {
                    for (sum, &c) in sums.iter_mut().zip(four) {
                        *sum += x(c);
                    }
                }
                rest.iter().for_each(|&c| sums[0] += x(c));
                for &(c, hits) in &self.often[self.often_start[i] as usize..self.often_start[i + 1] as usize] {
                    // Every number of a patch fits the columns.
                    let Ok(c) = C::try_from(c) else { continue };
                    sums[1] += hits * x(c);
                }
                *out = self.scale[i] * ((sums[0] + sums[1]) + (sums[2] + sums[3]));
            }
        });
    }
}
