//! Means and their standard errors from replicates.
//!
//! A round is a number of independent replicates of equal size; its mean has the variance that its replicates show.
//! Rounds are joined by their numbers of samples, which does not depend on what they found.

use super::walk::Light;
use crate::colour::luminance_f64;

/// Quantities whose errors are known: direct, indirect, total (three bands each), then their luminances.
const QUANTITIES: usize = 12;

/// What is known of one point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sums {
    /// Of all rounds: samples x mean.
    weighted: [f64; QUANTITIES],
    /// Of all rounds: samples^2 x variance of the mean.
    variance: [f64; QUANTITIES],
    samples: f64,
    /// Of all rounds: samples^2 / degrees of freedom.
    freedom: f64,
}

impl Default for Sums {
    fn default() -> Sums {
        Sums { weighted: [0.0; QUANTITIES], variance: [0.0; QUANTITIES], samples: 0.0, freedom: 0.0 }
    }
}

impl Sums {
    /// Adds replicates of `each` samples.
    pub fn add_round(&mut self, replicates: &[Light], each: u32) {
        let n = replicates.len() as f64;
        let samples = n * each as f64;
        let quantities = |light: &Light| -> [f64; QUANTITIES] {
            let l = light.map(|x| x / each as f64);
            let total = [l[0] + l[3], l[1] + l[4], l[2] + l[5]];
            let [direct, indirect] = [[l[0], l[1], l[2]], [l[3], l[4], l[5]]];
            let mut all = [0.0; QUANTITIES];
            for (k, bands) in [direct, indirect, total].iter().enumerate() {
                all[3 * k..3 * k + 3].copy_from_slice(bands);
                all[9 + k] = luminance_f64(*bands);
            }
            all
        };
        let mut mean = [0.0; QUANTITIES];
        for light in replicates {
            for (m, q) in mean.iter_mut().zip(quantities(light)) {
                *m += q / n;
            }
        }
        // Two passes: the spread may be a millionth of the mean.
        let mut squares = [0.0; QUANTITIES];
        for light in replicates {
            for ((s, q), m) in squares.iter_mut().zip(quantities(light)).zip(mean) {
                *s += (q - m) * (q - m);
            }
        }
        for k in 0..QUANTITIES {
            self.weighted[k] += samples * mean[k];
            self.variance[k] += samples * samples * squares[k] / (n * (n - 1.0));
        }
        self.samples += samples;
        self.freedom += samples * samples / (n - 1.0);
    }

    /// Samples of all rounds.
    pub fn samples(&self) -> f64 {
        self.samples
    }

    /// Of the joint variance (Welch 1947, Satterthwaite 1946), each sample being as noisy as the next.
    pub fn degrees_of_freedom(&self) -> f64 {
        self.samples * self.samples / self.freedom
    }

    fn mean(&self, k: usize) -> f64 {
        self.weighted[k] / self.samples
    }

    fn error(&self, k: usize) -> f64 {
        self.variance[k].sqrt() / self.samples
    }

    pub fn direct(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| self.mean(k))
    }

    pub fn indirect(&self) -> [f64; 3] {
        [3, 4, 5].map(|k| self.mean(k))
    }

    pub fn direct_error(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| self.error(k))
    }

    pub fn indirect_error(&self) -> [f64; 3] {
        [3, 4, 5].map(|k| self.error(k))
    }

    pub fn total_error(&self) -> [f64; 3] {
        [6, 7, 8].map(|k| self.error(k))
    }

    /// Luminance of the total.
    pub fn luminance(&self) -> f64 {
        self.mean(11)
    }

    /// Of the luminance of direct light, of indirect light and of their sum.
    pub fn luminance_errors(&self) -> [f64; 3] {
        [9, 10, 11].map(|k| self.error(k))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_join_by_their_samples() {
        let of = |x: f64| [x, 0.0, 0.0, 0.0, 0.0, 0.0];
        let mut sums = Sums::default();
        // Means of 1, 3: mean 2, variance of the mean ((1 + 1) / 1) / 2 = 1; 4 samples.
        sums.add_round(&[of(2.0), of(6.0)], 2);
        assert_eq!((sums.direct()[0], sums.direct_error()[0], sums.degrees_of_freedom()), (2.0, 1.0, 1.0));
        // Means of 4, 4, 4: no variance, 12 samples. Joined: (4 x 2 + 12 x 4) / 16, sqrt(4^2 x 1) / 16.
        sums.add_round(&[of(16.0), of(16.0), of(16.0)], 4);
        assert_eq!((sums.direct()[0], sums.direct_error()[0]), (3.5, 0.25));
        assert_eq!(sums.degrees_of_freedom(), 16.0 * 16.0 / (16.0 / 1.0 + 144.0 / 2.0));
        assert_eq!(sums.total_error()[0], 0.25);
        assert!((sums.luminance() - 0.2126 * 3.5).abs() < 1e-15);
    }
}
