//! What a frame computes.

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::{Relighter, sent::Sent};
use crate::{light, solve, transfer};

impl Relighter {
    /// Direct irradiance of the patch of a row, over the part of it that is not hidden.
    pub(super) fn direct_of(&self, row: usize) -> Vec3 {
        let sum: Vec3 = self.patch_direct.iter().map(|direct| direct[row]).sum();
        (sum * self.shown[row]).min(Vec3::MAX)
    }

    /// Direct light of the patches from the sources that have changed, and what the patches reflect of that of all; the
    /// shadow rays that it took.
    pub(super) fn light_patches(&mut self) -> u64 {
        let (samples, seed) = (self.options.patch_samples, self.bake.options.seed);
        let mut rays = 0;
        for (source, direct) in self.sources.iter().zip(&mut self.patch_direct).filter(|s| s.1.is_empty()) {
            let result = light::irradiance_of_few(
                &source.lights,
                self.bake.tracer(),
                &self.points,
                samples as usize,
                samples,
                seed,
            );
            rays += result.rays;
            *direct = result.irradiance;
        }
        let reflected = |k: usize| self.solution.albedo[k] * self.direct_of(k).extend(0.0);
        self.solution.source = (0..self.transport.len()).into_par_iter().with_min_len(4096).map(reflected).collect();
        rays + self.send_bright()
    }

    /// Takes the first reflection of bright patches out of what goes by form factors, and sends it by shadow rays, whose number
    /// is told.
    fn send_bright(&mut self) -> u64 {
        let Relighter { bake, transport, solution, points, shown, .. } = self;
        self.sent = Sent::new(bake, transport, solution, points, shown);
        let Some(sent) = &self.sent else { return 0 };
        for (k, (source, received)) in solution.source.iter_mut().zip(&sent.received).enumerate() {
            if sent.patches.binary_search(&transport.patches[k]).is_ok() {
                *source = Vec4::ZERO;
            }
            *source += solution.albedo[k] * *received;
        }
        sent.rays
    }

    /// Indirect light of the vertices; the shadow rays that it took.
    pub(super) fn light_vertices(&mut self) -> u64 {
        let Relighter { bake, solution, factors, .. } = self;
        let Some(sent) = &self.sent else {
            factors.carry(&solution.irradiance, &mut bake.vertices.indirect);
            return 0;
        };
        factors.carry(&solution.irradiance, &mut bake.vertices.indirect);
        let (more, rays) = sent.at(bake);
        bake.vertices.indirect.iter_mut().zip(more).for_each(|(e, more)| *e = (*e + more).min(Vec3::MAX));
        rays
    }

    /// Solves for indirect light; the sweeps, and what is left to do as a share of all radiosity.
    pub(super) fn solve(&mut self) -> (usize, f64) {
        let tolerance = self.options.tolerance;
        let (sweeps, rest) = self.solution.solve(&self.transport, tolerance);
        if rest <= tolerance {
            return (sweeps, rest);
        }
        // Surfaces so white that light stays on them for very many reflections, or numbers beyond f32.
        let patches = &self.transport.patches;
        let (mut source, mut albedo) = (vec![[0.0; 3]; self.bake.form_factors.len()], Vec::new());
        albedo.extend(self.bake.simplified.patches.albedo.iter().map(|a| a.to_array().map(f64::from)));
        for (k, &i) in patches.iter().enumerate() {
            source[i as usize] = self.solution.source[k].truncate().to_array().map(f64::from);
        }
        let exact = solve::solve(&self.bake.form_factors, &albedo, &source, 0.1 * tolerance, false);
        let value = |v: [f64; 3]| Vec3::from_array(v.map(|x| x as f32)).min(Vec3::MAX).extend(0.0);
        for (k, &i) in patches.iter().enumerate() {
            self.solution.radiosity[k] = value(exact.radiosity[i as usize]);
            self.solution.irradiance[k] = value(exact.irradiance[i as usize]);
        }
        (sweeps + 2 * exact.iterations, exact.residual)
    }

    /// Where shadow rays of the patches start.
    pub(super) fn place_points(&mut self) {
        let (samples, seed) = (self.options.patch_samples, self.bake.options.seed);
        self.points = transfer::patch_points(&self.bake.simplified, &self.transport.patches, samples, seed);
    }
}
