//! The random numbers of all receivers.

use crate::{sampling, scene::SurfacePoint};

/// One Sobol point set for all receivers; each shifts the bits by its own hash, which keeps every stratum.
pub(super) struct Numbers {
    /// (u, v, pick) of every sample, 32 bits each.
    of_sample: Vec<[u32; 3]>,
    seed: u64,
}

impl Numbers {
    pub fn new(samples: u32, points_per_receiver: usize, seed: u64) -> Numbers {
        // The first two dimensions of the same points chose the places on the patch (see `irradiance`).
        let first = if points_per_receiver > 1 { 2 } else { 0 };
        let bits = |x: f32| (x as f64 * 4_294_967_296.0) as u32;
        let of_sample = (0..samples)
            .map(|k| {
                let place = sampling::sobol4(k, seed);
                let pick = if first == 0 { place[2] } else { sampling::sobol4(k, !seed)[0] };
                [bits(place[first]), bits(place[first + 1]), bits(pick)]
            })
            .collect();
        Numbers { of_sample, seed }
    }

    /// How many samples.
    pub fn len(&self) -> usize {
        self.of_sample.len()
    }

    /// (u, v, pick) of `sample`, each in [0, 1), for whoever has `shift`.
    pub fn shifted(&self, sample: usize, shift: u64) -> [f32; 3] {
        let unit = |bits: u32| (bits >> 8) as f32 * (1.0 / 16_777_216.0);
        let [u, v, pick] = self.of_sample[sample];
        [unit(u ^ shift as u32), unit(v ^ (shift >> 32) as u32), unit(pick ^ (shift >> 16) as u32)]
    }

    /// u and v of all samples for whoever has `shift`.
    pub fn shift_all(&self, shift: u64, u: &mut [f32], v: &mut [f32]) {
        // Signed integers convert in one vector instruction, unsigned ones do not.
        let unit = |bits: u32| (bits >> 8) as i32 as f32 * (1.0 / 16_777_216.0);
        for ((u, v), bits) in u.iter_mut().zip(v).zip(&self.of_sample) {
            (*u, *v) = (unit(bits[0] ^ shift as u32), unit(bits[1] ^ (shift >> 32) as u32));
        }
    }

    /// Random bits that depend on where a receiver is, not on its place in a list: equal points get equal light.
    pub fn identity(&self, x: &SurfacePoint) -> u64 {
        // Adding zero makes -0 equal to 0.
        let bits = |v: f32| (v + 0.0).to_bits() as u64;
        let (p, n) = (x.position, x.normal);
        let words = [bits(p.x) << 32 | bits(p.y), bits(p.z) << 32 | bits(n.x), bits(n.y) << 32 | bits(n.z)];
        sampling::hash(&[self.seed, words[0], words[1], words[2]])
    }
}
