//! Random numbers: stratified for the first two vertices of a path, hashed for all others.

use crate::sampling;

/// Samples that one table of stratified numbers holds.
pub(super) const MOST_STRATIFIED: u32 = 4096;

/// What a random number decides.
#[derive(Clone, Copy)]
pub(super) enum Decision {
    /// Which lamp, and where on it.
    Lamp,
    /// The other coordinate of the place on the lamp.
    LampToo,
    /// Where the path goes on.
    Direction,
    /// The other coordinate of the direction.
    DirectionToo,
    /// Whether the path goes on from the next vertex.
    Roulette,
}

/// Owen-scrambled Sobol points in eight dimensions, shared by all receivers, which XOR them with random words of their
/// own (a digital shift): strata stay, and differently shifted sets are independent.
pub(super) struct Table {
    /// lamp 0, lamp 1, direction 0, direction 1 of the receiver, then of the first reflection.
    dimensions: [Vec<u32>; 8],
}

impl Table {
    /// `samples` points, in Morton order of the receiver's directions, so that neighbouring rays stay together.
    pub fn new(samples: u32, seed: u64) -> Table {
        let bits = |x: f32| (x as f64 * 4_294_967_296.0) as u32;
        let other = sampling::hash(&[seed, 0x7265_6665]);
        let mut points: Vec<[u32; 8]> = (0..samples)
            .map(|k| {
                let (a, b) = (sampling::sobol4(k, seed).map(bits), sampling::sobol4(k, other).map(bits));
                [b[0], b[1], a[0], a[1], a[2], a[3], b[2], b[3]]
            })
            .collect();
        points.sort_by_key(|p| (spread(p[2]) << 1) | spread(p[3]));
        Table { dimensions: std::array::from_fn(|d| points.iter().map(|p| p[d]).collect()) }
    }

    /// Points of the table.
    pub fn len(&self) -> usize {
        self.dimensions[0].len()
    }

    /// Word `dimension` of point `k`.
    #[inline]
    fn word(&self, dimension: usize, k: u32) -> u32 {
        self.dimensions[dimension][k as usize]
    }
}

/// The upper 16 bits of `x`, a zero between each two.
fn spread(x: u32) -> u64 {
    let mut x = (x >> 16) as u64;
    for (shift, mask) in [(8, 0x00ff_00ff), (4, 0x0f0f_0f0f), (2, 0x3333_3333), (1, 0x5555_5555)] {
        x = (x | (x << shift)) & mask;
    }
    x
}

/// The words with which one receiver shifts a table, one a dimension, and the root of its hashed numbers.
#[derive(Clone, Copy, Default)]
pub(super) struct Shift {
    words: [u32; 8],
    root: u32,
}

impl Shift {
    /// That of a replicate of a receiver; `identity` tells it from all others.
    pub fn new(identity: &[u64; 4]) -> Shift {
        let mut word = sampling::hash(identity);
        let pairs: [u64; 5] = std::array::from_fn(|_| {
            word = sampling::hash(&[word]);
            word
        });
        let words = std::array::from_fn(|k| (pairs[k / 2] >> (32 * (k % 2))) as u32);
        Shift { words, root: pairs[4] as u32 }
    }

    /// The root of the hashed numbers of sample `k`.
    pub fn key(&self, k: u32) -> u32 {
        mix(self.root ^ k.wrapping_mul(GOLDEN))
    }
}

const GOLDEN: u32 = 0x9e37_79b9;

/// A bijection that leaves no bit of its argument to be seen ("lowbias32", Wellons 2018).
#[inline]
fn mix(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Who a path is.
#[derive(Clone, Copy, Default)]
pub(super) struct Identity {
    /// Its receiver in the batch.
    pub slot: u32,
    /// Its sample.
    pub sample: u32,
    /// [`Shift::key`] of the sample.
    pub key: u32,
}

/// The random numbers of vertices after so many reflections.
#[derive(Clone, Copy)]
pub(super) struct Numbers<'a> {
    pub table: &'a Table,
    pub shifts: &'a [Shift],
    pub bounce: u32,
}

impl Numbers<'_> {
    /// A 32-bit fraction.
    #[inline(always)]
    pub fn word(&self, path: &Identity, decision: Decision) -> u32 {
        let which = decision as u32;
        if self.bounce < 2 && which < 4 {
            let d = (4 * self.bounce + which) as usize;
            self.table.word(d, path.sample) ^ self.shifts[path.slot as usize].words[d]
        } else {
            mix(path.key.wrapping_add((5 * self.bounce + which + 1).wrapping_mul(GOLDEN)))
        }
    }
}

/// A fixed-point fraction as a float in [0, 1).
#[inline]
pub(super) fn fraction(x: u32) -> f32 {
    // Signed integers convert in one vector instruction, unsigned ones do not.
    (x >> 8) as i32 as f32 * (1.0 / 16_777_216.0)
}

/// A point of the unit sphere, uniform: z and azimuth. Free of branches and calls, so that loops over it vectorise.
#[inline]
pub(super) fn on_sphere(u: u32, v: u32) -> [f32; 3] {
    let z = 1.0 - 2.0 * (fraction(u) + 0.5 / 16_777_216.0);
    let r = (1.0 - z * z).max(0.0).sqrt();
    // The upper two bits are the quadrant; within it angles from -pi/4 to pi/4, where short series do.
    let quadrant = v >> 30;
    let x = (fraction(v << 2) - 0.5) * std::f32::consts::FRAC_PI_2;
    let y = x * x;
    let sin = x * (1.0 + y * (-1.0 / 6.0 + y * (1.0 / 120.0 + y * (-1.0 / 5040.0 + y * (1.0 / 362_880.0)))));
    let cos = 1.0 + y * (-0.5 + y * (1.0 / 24.0 + y * (-1.0 / 720.0 + y * (1.0 / 40_320.0))));
    let swap = quadrant & 1 == 1;
    let (a, b) = if swap { (sin, cos) } else { (cos, sin) };
    // (c, s), (-s, c), (-c, -s), (s, -c)
    let negative_a = ((quadrant + 1) & 2) << 30;
    let negative_b = (quadrant & 2) << 30;
    [r * f32::from_bits(a.to_bits() ^ negative_a), r * f32::from_bits(b.to_bits() ^ negative_b), z]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_the_sphere_are_unit_and_spread_evenly() {
        let n = 1 << 16;
        let table = Table::new(4096, 3);
        let (mut sum, mut squares) = ([0.0_f64; 3], [0.0_f64; 6]);
        for i in 0..n {
            let k = i % 4096;
            let shift = Shift::new(&[1, 2, 3, (i / 4096) as u64]);
            let [x, y, z] = on_sphere(table.word(2, k) ^ shift.words[2], table.word(3, k) ^ shift.words[3]);
            assert!((x * x + y * y + z * z - 1.0).abs() < 1e-6);
            for (s, v) in sum.iter_mut().zip([x, y, z]) {
                *s += v as f64 / n as f64;
            }
            for (s, v) in squares.iter_mut().zip([x * x, y * y, z * z, x * y, y * z, z * x]) {
                *s += v as f64 / n as f64;
            }
        }
        // Deviations of as many independent points: sqrt(1/3), sqrt(4/45) and sqrt(1/15); four of them.
        let deviation = |variance: f64| 4.0 * (variance / n as f64).sqrt();
        assert!(sum.iter().all(|s| s.abs() < deviation(1.0 / 3.0)), "{sum:?}");
        assert!(squares[..3].iter().all(|s| (s - 1.0 / 3.0).abs() < deviation(4.0 / 45.0)), "{squares:?}");
        assert!(squares[3..].iter().all(|s| s.abs() < deviation(1.0 / 15.0)), "{squares:?}");
    }

    #[test]
    fn the_azimuth_runs_around_once() {
        for i in 0..64_u32 {
            let [x, y, _] = on_sphere(1 << 31, i << 26);
            let angle = (y.atan2(x) + std::f32::consts::FRAC_PI_4).rem_euclid(std::f32::consts::TAU);
            assert!((angle - i as f32 / 64.0 * std::f32::consts::TAU).abs() < 1e-5, "{i}: {angle}");
        }
    }
}
