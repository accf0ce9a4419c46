//! The same light on patches of twice the size.
//!
//! No ray is cast: a coarse patch is made of patches of the bake, its row is the mean of theirs, and so is its albedo.
//! In expectation that is what a bake with voxels of twice the size computes; but its noise is that of the bake itself,
//! so that the difference of the two solutions tells of the size of the patches and hardly of noise.

use glam::Vec3;
use rayon::prelude::*;

use super::patches::Field;
use crate::{
    Scene,
    bake::Bake,
    options::PatchSource,
    reconstruct::{self, Level, PatchIndex},
    simplify::{self, Grid, NO_PATCH, Simplified, clip::uv_centroid},
    trace::Hit,
};

/// Bounces that carry the change on. The change of light by larger patches is to both sides and nearly cancels in what
/// is sent on, so a second bounce changes the answer little and a third not at all.
const BOUNCES: usize = 2;

/// Patches of twice the size, and which of the bake's patches make them.
pub struct Coarse {
    simplified: Simplified,
    index: PatchIndex,
    level: Level,
    /// Coarse patch of each patch; [`NO_PATCH`] where none was found.
    parent: Vec<u32>,
    /// Visible area of each patch.
    area: Vec<f64>,
    /// Visible area of the members of each coarse patch.
    total: Vec<f64>,
    known: Vec<bool>,
}

/// Light of coarse patches.
pub struct CoarseLight {
    /// Irradiance of the coarse patches, W/m2.
    pub received: Vec<[f64; 3]>,
    /// Radiosity that it comes from, W/m2: of the bake's own patches, equal over each coarse one.
    pub sent: Vec<[f64; 3]>,
}

impl Coarse {
    pub fn new(scene: &Scene, bake: &Bake) -> Coarse {
        let fine = bake.simplified.grid;
        // Every voxel holds eight of the bake's.
        let grid = Grid { voxel_size: 2.0 * fine.voxel_size, dims: fine.dims.map(|n| n.div_ceil(2)), ..fine };
        let mut simplified = simplify::surfels(scene, grid, bake.tracer());
        let patches = bake.patches();
        let all = (0..patches.len()).into_par_iter();
        let parent: Vec<u32> = match bake.options.patches {
            PatchSource::Surfels => all.map(|i| same_surface(&bake.simplified, &simplified, i)).collect(),
            _ => {
                let index = PatchIndex::new(&simplified.patches, grid);
                all.map(|i| nearest(bake, &simplified, &index, i)).collect()
            }
        };
        // Patches that light does not reach are known to be dark.
        let area: Vec<f64> =
            (0..patches.len())
                .map(|i| {
                    if bake.light.known[i] { patches.area[i] as f64 * (1.0 - bake.form_factors.hidden(i)) } else { 0.0 }
                })
                .collect();
        let mut total = vec![0.0; simplified.patches.len()];
        let mut middle = vec![glam::DVec3::ZERO; total.len()];
        for (i, &p) in parent.iter().enumerate().filter(|p| *p.1 != NO_PATCH) {
            total[p as usize] += area[i];
            middle[p as usize] += area[i] * patches.centroid[i].as_dvec3();
        }
        // A mean of light stands where its members are.
        for (p, &total) in total.iter().enumerate().filter(|p| *p.1 > 0.0) {
            simplified.patches.centroid[p] = (middle[p] / total).as_vec3();
        }
        let known = total.iter().map(|&a| a > 0.0).collect();
        let index = PatchIndex::new(&simplified.patches, grid);
        Coarse { simplified, index, level: Level::default(), parent, area, total, known }
    }

    /// Means of the values of patches over the coarse ones.
    pub fn average(&self, values: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let mut sums = vec![[0.0; 3]; self.total.len()];
        for (i, &p) in self.parent.iter().enumerate().filter(|p| *p.1 != NO_PATCH) {
            let p = p as usize;
            if self.total[p] > 0.0 {
                let share = self.area[i] / self.total[p];
                sums[p] = std::array::from_fn(|c| sums[p][c] + share * values[i][c]);
            }
        }
        sums
    }

    /// The light of the coarse patches if what is sent is the same over each of them.
    pub fn light(&self, bake: &Bake, field: &Field) -> CoarseLight {
        let albedo = rgb(&bake.patches().albedo);
        let own = rgb(field.sent);
        let sent = self.average(&own);
        if !field.reflects {
            return self.exchange(bake, &own, &sent);
        }
        let total: Vec<[f64; 3]> = rgb(&bake.light.direct)
            .iter()
            .zip(rgb(&bake.light.indirect))
            .map(|(a, b)| std::array::from_fn(|c| a[c] + b[c]))
            .collect();
        let product: Vec<[f64; 3]> =
            albedo.iter().zip(&total).map(|(a, e)| std::array::from_fn(|c| a[c] * e[c])).collect();
        let (albedo, total, product) = (self.average(&albedo), self.average(&total), self.average(&product));
        // A large patch has one albedo and one irradiance: what they have in common within it is lost.
        let sent: Vec<[f64; 3]> = (0..sent.len())
            .map(|p| std::array::from_fn(|c| sent[p][c] - product[p][c] + albedo[p][c] * total[p][c]))
            .collect();
        let before = self.average(&rgb(field.received));
        let mut light = self.exchange(bake, &own, &sent);
        for _ in 1..BOUNCES {
            let changed: Vec<[f64; 3]> = (0..sent.len())
                .map(|p| std::array::from_fn(|c| sent[p][c] + albedo[p][c] * (light.received[p][c] - before[p][c])))
                .collect();
            light = self.exchange(bake, &own, &changed);
        }
        light
    }

    /// What coarse patches receive of what they send; patches that belong to none send their `own`.
    fn exchange(&self, bake: &Bake, own: &[[f64; 3]], sent: &[[f64; 3]]) -> CoarseLight {
        let of_patch = |(i, &p): (usize, &u32)| match p {
            NO_PATCH => own[i],
            p if self.known[p as usize] => sent[p as usize],
            _ => own[i],
        };
        let sent: Vec<[f64; 3]> = self.parent.iter().enumerate().map(of_patch).collect();
        let mut received = vec![[0.0; 3]; sent.len()];
        bake.form_factors.multiply(&sent, &mut received);
        CoarseLight { received: self.average(&received), sent }
    }

    /// The field of `values` of the coarse patches, for interpolation.
    pub fn field<'a>(&'a self, bake: &'a Bake, values: &'a [Vec3]) -> reconstruct::Field<'a> {
        reconstruct::Field {
            simplified: &self.simplified,
            index: &self.index,
            known: &self.known,
            level: &self.level,
            stencils: None,
            ..bake.field(values, &bake.carried)
        }
    }
}

/// The coarse patch that holds the largest piece of patch `i`.
fn same_surface(fine: &Simplified, coarse: &Simplified, i: usize) -> u32 {
    let area = |m: u32| {
        let f = (m >> 1) as usize;
        fine.fragments.area(f, &fine.corners(fine.fragments.triangle[f] as usize))
    };
    let Some(largest) = fine.patches.members(i).iter().copied().max_by(|&a, &b| area(a).total_cmp(&area(b))) else {
        return NO_PATCH;
    };
    let f = (largest >> 1) as usize;
    let at = uv_centroid(fine.fragments.uv(f));
    let hit = Hit { t: 0.0, u: at.x, v: at.y, face: fine.fragments.triangle[f] << 1 | (largest & 1) };
    coarse.hit_map.patch(&coarse.fragments, &hit)
}

/// The nearest coarse patch that faces like patch `i`.
fn nearest(bake: &Bake, coarse: &Simplified, index: &PatchIndex, i: usize) -> u32 {
    let (centre, normal) = (bake.patches().centroid[i], bake.patches().normal[i]);
    let mut best = (f32::INFINITY, NO_PATCH);
    index.near(centre, 1.0, |j| {
        let entry = (coarse.patches.centroid[j].distance_squared(centre), j as u32);
        if coarse.patches.normal[j].dot(normal) > 0.5 && entry < best {
            best = entry;
        }
    });
    best.1
}

fn rgb(values: &[Vec3]) -> Vec<[f64; 3]> {
    values.iter().map(|v| v.to_array().map(f64::from)).collect()
}
