//! Pregenerated point sets: where rays start on a patch and where they go.

use std::{ops::Range, sync::OnceLock};

use super::cast::row_length;
use crate::{lxt::Array, sampling, trace::RayTracer};

/// The points of the rows of a bake. Sets are made when they are first asked for, by one thread, so that any may ask at
/// any time; all who cast rows of the bake share them.
pub struct RowPoints {
    rays: u32,
    seed: u64,
    packets: bool,
    rows: OnceLock<PointSets>,
    fewer: OnceLock<PointSets>,
}

impl RowPoints {
    /// Of rows of so many rays, a power of two, at most 65536, that `tracer` traces.
    pub fn new(rays: u32, seed: u64, tracer: &dyn RayTracer) -> RowPoints {
        RowPoints { rays, seed, packets: tracer.traces_packets(), rows: OnceLock::new(), fewer: OnceLock::new() }
    }

    /// As [`RowPoints::new`]; usual rows have these.
    pub fn with_rows(rows: PointSets, seed: u64, tracer: &dyn RayTracer) -> RowPoints {
        let rays = rows.len as u32;
        RowPoints { rows: OnceLock::from(rows), ..RowPoints::new(rays, seed, tracer) }
    }

    /// Rays of a usual row.
    pub fn rays(&self) -> u32 {
        self.rays
    }

    /// Seed of all random numbers.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Points of usual rows.
    pub fn rows(&self) -> &PointSets {
        self.rows.get_or_init(|| PointSets::new(self.rays as usize, self.seed, self.packets))
    }

    /// Points of rows that have fewer rays.
    pub fn fewer(&self) -> &PointSets {
        self.fewer.get_or_init(|| PointSets::new(row_length(self.rays, true) as usize, self.seed, self.packets))
    }

    /// Rays of a probe: of usual rows, as many as must be cast to know what the leading ones meet.
    pub fn probe_rays(&self) -> usize {
        probe(self.rays as usize, self.packets)
    }
}

/// Several independent Owen-scrambled Sobol sets over direction x origin (four dimensions), made once.
///
/// A patch takes one set, turns its directions by a random azimuth and flips random bits of its origins. Both keep
/// the strata and leave every single ray uniformly distributed; they cost a few instructions a ray, where fresh
/// scrambled points cost 26 ns. The points are in Morton order of their direction cells, so that neighbouring rays fly
/// alike and packets stay together.
///
/// The first 64 points of the sequence lead: they are as evenly spread as the whole, and tell whether the patch is
/// hidden and whether it sees light. They stand before the others, so that they can be cast alone; but not in short sets
/// for tracers of packets, which would be a quarter slower for it. There a probe takes the whole row: which of two
/// triangles at the same distance a ray meets depends on its packet, and a probe must meet what the row meets.
#[derive(Clone)]
pub struct PointSets {
    /// Points in a set; a power of two.
    pub len: usize,
    /// So many at the head of a set hold the leading ones.
    pub probe: usize,
    /// x, y and z of unit directions, cosine-distributed about +z; sets one after the other.
    pub directions: [Array<f32>; 3],
    /// Coordinates of the origins: fixed-point fractions of 16 bits, the first in the upper half.
    pub origin: Array<u32>,
    /// Where the leading points stand in their sets.
    pub leading: Array<u16>,
    sets: usize,
}

/// Points in all sets together, at least 16 sets. They take 256 KiB, so that they stay in a near cache: with four times
/// as many, half the time of making rays was waiting for them.
const POINTS: usize = 1 << 14;
/// Points of a set that tell whether its patch is hidden, and whether it sees light.
pub const LEADING: usize = 64;
/// Longest rows whose leading rays have their places among the others in packets. In longer ones they are few.
const MOST_MIXED: usize = 512;

/// How many sets there are of `len` points each.
fn sets(len: usize) -> usize {
    (POINTS / len).max(16)
}

fn probe(len: usize, packets: bool) -> usize {
    if packets && len <= MOST_MIXED { len } else { LEADING.min(len) }
}

impl PointSets {
    /// Makes sets of `len` points (a power of two, at most 65536), for a tracer that traces successive rays as `packets`
    /// or not.
    pub fn new(len: usize, seed: u64, packets: bool) -> PointSets {
        let (sets, probe) = (sets(len), probe(len, packets));
        let mut directions = [0; 3].map(|_| Vec::with_capacity(sets * len));
        let mut origin = Vec::with_capacity(sets * len);
        let mut push = |point: &Point| {
            let [u, v, a, b] = point.at;
            let d = sampling::cosine_hemisphere(u, v).to_array();
            directions.iter_mut().zip(d).for_each(|(all, d)| all.push(d));
            origin.push(fixed_point(a) & 0xffff_0000 | fixed_point(b) >> 16);
        };
        let mut leading = Vec::with_capacity(sets * LEADING.min(len));
        let mut cells = vec![Point::default(); len];
        for set in 0..sets {
            let seed = sampling::hash(&[seed, POINT_SETS, set as u64]);
            fill(&mut cells, seed);
            if probe == len {
                leading.extend((0..).zip(&cells).filter(|(_, point)| point.leads).map(|(k, _)| k));
                cells.iter().for_each(&mut push);
            } else {
                leading.extend(0..LEADING as u16);
                for leads in [true, false] {
                    cells.iter().filter(|point| point.leads == leads).for_each(&mut push);
                }
            }
        }
        let directions = directions.map(Array::from);
        PointSets { len, probe, directions, origin: origin.into(), leading: leading.into(), sets }
    }

    /// Sets that somebody has [made](PointSets::new) of these arrays; `None` if they are no such sets.
    pub fn of_arrays(
        len: usize,
        packets: bool,
        directions: [Array<f32>; 3],
        origin: Array<u32>,
        leading: Array<u16>,
    ) -> Option<PointSets> {
        let sets = sets(len);
        let all = directions.iter().all(|d| d.len() == sets * len) && origin.len() == sets * len;
        let sound = directions.iter().flatten().all(|d| (-1.0..=1.0).contains(d))
            && leading.len() == sets * LEADING.min(len)
            && leading.iter().all(|&k| (k as usize) < len);
        (all && sound).then(|| PointSets { len, probe: probe(len, packets), directions, origin, leading, sets })
    }

    /// The part of the arrays that set number `random` (modulo the number of sets) takes.
    pub fn set(&self, random: u64) -> Range<usize> {
        let set = self.number(random);
        set * self.len..(set + 1) * self.len
    }

    /// Where the leading points of that set stand in it.
    pub fn leading(&self, random: u64) -> &[u16] {
        let count = LEADING.min(self.len);
        &self.leading[self.number(random) * count..][..count]
    }

    fn number(&self, random: u64) -> usize {
        (random % self.sets as u64) as usize
    }
}

/// Purpose word of the sets' seeds.
const POINT_SETS: u64 = 0x706f_696e_7473;

#[derive(Clone, Copy, Default)]
struct Point {
    /// Direction and origin in the unit square.
    at: [f32; 4],
    leads: bool,
}

/// Puts the first points of a sequence, as many as there are cells, in Morton order of their directions. These are a
/// (0, m, 2)-net, so that each cell gets one.
fn fill(cells: &mut [Point], seed: u64) {
    let unused = 32 - cells.len().ilog2();
    for i in 0..cells.len() {
        let at = sampling::sobol4(i as u32, seed);
        cells[(morton(at[0], at[1]) >> unused) as usize] = Point { at, leads: i < LEADING };
    }
}

fn fixed_point(x: f32) -> u32 {
    (x as f64 * 4_294_967_296.0) as u32
}

/// Interleaves the leading 16 bits of two fractions.
fn morton(u: f32, v: f32) -> u32 {
    let spread = |x: f32| {
        let mut b = fixed_point(x) as u64 >> 16;
        b = (b | b << 8) & 0x00ff_00ff;
        b = (b | b << 4) & 0x0f0f_0f0f;
        b = (b | b << 2) & 0x3333_3333;
        (b | b << 1) & 0x5555_5555
    };
    (spread(u) | spread(v) << 1) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_direction_cell_of_a_set_holds_one_point() {
        for power in 4..=16 {
            let mut cells = vec![Point::default(); 1 << power];
            for seed in 0..3 {
                cells.fill(Point { at: [-1.0; 4], leads: false });
                fill(&mut cells, seed);
                assert!(cells.iter().all(|point| point.at[0] >= 0.0), "2^{power} points, seed {seed}");
            }
        }
    }

    #[test]
    fn quadrants_of_the_hemisphere_get_equally_many_directions() {
        let sets = PointSets::new(256, 1, true);
        for set in [0, 7] {
            let mut quadrants = [0; 4];
            for i in sets.set(set) {
                let [x, y] = [0, 1].map(|axis| (sets.directions[axis][i] > 0.0) as usize);
                quadrants[2 * x + y] += 1;
            }
            assert_eq!(quadrants, [64; 4]);
        }
    }

    #[test]
    fn leading_points_are_the_same_wherever_they_stand_and_one_of_each_64th_of_directions() {
        let (mixed, apart) = (PointSets::new(256, 3, true), PointSets::new(256, 3, false));
        assert_eq!((mixed.probe, apart.probe), (256, 64));
        let points = |sets: &PointSets, which: &mut dyn Iterator<Item = usize>| -> Vec<(u32, u32)> {
            which.map(|k| (sets.directions[0][k].to_bits(), sets.origin[k])).collect()
        };
        for set in [0, 5] {
            let first = mixed.set(set).start;
            let leading = |sets: &PointSets| points(sets, &mut sets.leading(set).iter().map(|&k| first + k as usize));
            assert_eq!(leading(&mixed), leading(&apart));
            // In Morton order, four points a cell.
            assert!(mixed.leading(set).iter().zip(0..).all(|(&k, cell)| k / 4 == cell));
            let all = |sets: &PointSets| {
                let mut all = points(sets, &mut sets.set(set));
                all.sort_unstable();
                all
            };
            assert_eq!(all(&mixed), all(&apart));
        }
    }

    #[test]
    fn mean_cosine_of_a_set_is_two_thirds() {
        let sets = PointSets::new(1024, 2, false);
        let mean = sets.set(3).map(|i| sets.directions[2][i] as f64).sum::<f64>() / 1024.0;
        // Standard deviation of a cosine is 0.236; a random set would give 0.0074, a stratified one far less.
        assert!((mean - 2.0 / 3.0).abs() < 0.002, "{mean}");
    }
}
