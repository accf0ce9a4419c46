//! Bright patches in frames: their first reflection is sent by shadow rays, as in a bake.

use glam::{Vec3, Vec4};

use super::{solution::Solution, transport::Transport};
use crate::{
    bake::{self, Bake},
    light::{Bright, Crowd, LightSet},
    scene::SurfacePoint,
};

/// Shadow rays a receiver, all bright patches together: what they give in full view has no noise.
const SAMPLES: u32 = 16;

/// Bright patches and what they send.
pub(super) struct Sent {
    /// The bright patches, in order, and the first reflection of each, W/m2.
    pub patches: Vec<u32>,
    exitance: Vec<Vec3>,
    crowd: Crowd,
    /// The irradiance of the rows of the transport from them, W/m2.
    pub received: Vec<Vec4>,
    /// Shadow rays that it took.
    pub rays: u64,
}

impl Sent {
    /// Sends the first reflection of the bright patches to the patches of the rows, if there are any that are worth it and the
    /// balance of power is as good as a bake asks for. `points` of each row stand on it, `shown` is one over its visible share.
    pub fn new(
        bake: &Bake,
        transport: &Transport,
        solution: &Solution,
        points: &[SurfacePoint],
        shown: &[f32],
    ) -> Option<Sent> {
        let count = bake.form_factors.len();
        let (mut source, mut reached) = (vec![[0.0; 3]; count], vec![false; count]);
        for (&i, s) in transport.patches.iter().zip(&solution.source) {
            source[i as usize] = s.truncate().to_array().map(f64::from);
            reached[i as usize] = true;
        }
        let patches = Bright::patches(&bake.simplified, &source, &reached)?;
        let exitance = |i: u32| Vec3::from_array(source[i as usize].map(|s| s as f32));
        let crowd = Crowd::new(&bake.simplified, &patches, exitance);
        let per = points.len() / transport.len();
        let found = crowd.irradiance(bake.tracer(), points, per, SAMPLES, bake.options.seed);
        let received = found.irradiance.iter().zip(shown).map(|(e, s)| (s * *e).min(Vec3::MAX).extend(0.0)).collect();
        let exitance = patches.iter().map(|&i| exitance(i)).collect();
        let sent = Sent { patches, exitance, crowd, received, rays: found.rays };
        // As a bake: what slips past edges, or is lost there, must not become light.
        let f = &bake.form_factors;
        let area = |i: u32| bake.simplified.patches.area[i as usize] as f64 * (1.0 - f.hidden(i as usize));
        let arrives = transport.patches.iter().zip(&sent.received);
        let arrives: f64 = arrives.map(|(&i, e)| area(i) * e.element_sum() as f64).sum();
        let leaves = sent.exitance();
        let leaves: f64 = leaves.map(|(i, b)| area(i) * b.element_sum() as f64 * (1.0 - f.escape(i as usize))).sum();
        bake::is_balanced(arrives, leaves).then_some(sent)
    }

    /// Irradiance of vertices from the bright patches, W/m2; and the shadow rays that it took.
    pub fn at(&self, bake: &Bake) -> (Vec<Vec3>, u64) {
        let found = self.crowd.irradiance(bake.tracer(), &bake.mesh.samples, 1, SAMPLES, bake.options.seed);
        (found.irradiance, found.rays)
    }

    /// The bright patches as lamps.
    pub fn lights(&self, bake: &Bake) -> LightSet {
        let of = |i: u32| self.patches.binary_search(&i).map_or(Vec3::ZERO, |k| self.exitance[k]);
        Bright::lights(&bake.simplified, &self.patches, |i| of(i) / std::f32::consts::PI)
    }

    /// First reflection of the bright patches, W/m2.
    pub fn exitance(&self) -> impl Iterator<Item = (u32, Vec3)> {
        self.patches.iter().copied().zip(self.exitance.iter().copied())
    }
}
