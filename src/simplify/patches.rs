//! Patches: what exchanges light in the radiosity system.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::{
    clip::{Fragments, NO_PATCH, point_at, uv_centroid},
    corners,
    layers::LIFT,
    normal_of,
};
use crate::{Scene, lxt::Array, trace::Geometry};

/// The patches of the radiosity system, structure of arrays; local units. Sorted by voxel in raster order.
#[derive(Clone, Debug, Default)]
pub struct Patches {
    /// Area.
    pub area: Array<f32>,
    /// Area-weighted mean position.
    pub centroid: Array<Vec3>,
    /// Where rays to other points of the same surface start: slightly above it, near the centroid.
    pub eye: Array<Vec3>,
    /// Unit mean normal.
    pub normal: Array<Vec3>,
    /// Mean albedo.
    pub albedo: Vec<Vec3>,
    /// Mean emitted exitance, W/m2.
    pub emitted: Vec<Vec3>,
    /// Raster position of the voxel.
    pub voxel: Array<u64>,
    /// Where the members of each patch begin; one more entry than patches.
    pub start: Array<u32>,
    /// `fragment * 2 + side` of every member.
    pub members: Array<u32>,
}

impl Patches {
    /// Number of patches.
    pub fn len(&self) -> usize {
        self.area.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.area.is_empty()
    }

    /// Members of patch `i`, as `fragment * 2 + side`.
    pub fn members(&self, i: usize) -> &[u32] {
        &self.members[self.start[i] as usize..self.start[i + 1] as usize]
    }

    /// Makes patches of groups of members and their colours, and tells the fragments. Eyes stand above the centroids.
    pub(super) fn of_groups(
        geometry: &Geometry,
        fragments: &mut Fragments,
        groups: Groups,
        colours: &[Colour],
        voxel_size: f32,
    ) -> Patches {
        let sides = fragments.patch.own();
        for (i, group) in groups.iter().enumerate() {
            for &m in group {
                debug_assert_eq!(sides[(m >> 1) as usize][(m & 1) as usize], NO_PATCH);
                sides[(m >> 1) as usize][(m & 1) as usize] = i as u32;
            }
        }
        let shapes: Vec<(f64, DVec3, DVec3)> =
            groups.par_iter().map(|group| shape(geometry, fragments, group)).collect();
        let voxel = groups.iter().map(|group| fragments.voxel[(group[0] >> 1) as usize]).collect();
        let mut patches =
            Patches { voxel, start: groups.start.into(), members: groups.members.into(), ..Patches::default() };
        patches.area = shapes.iter().map(|s| s.0 as f32).collect();
        patches.centroid = shapes.iter().map(|s| s.1.as_vec3()).collect();
        patches.normal = shapes.iter().map(|s| s.2.as_vec3()).collect();
        let lifted = |(p, n): (&Vec3, &Vec3)| p + LIFT * voxel_size * n;
        patches.eye = patches.centroid.iter().zip(&patches.normal).map(lifted).collect();
        patches.albedo = colours.iter().map(|c| c.albedo).collect();
        patches.emitted = colours.iter().map(|c| c.emitted).collect();
        patches
    }
}

/// Members of groups (`fragment * 2 + side`), one group after the other; none is empty.
pub(super) struct Groups {
    /// Where each begins; one more entry than groups.
    start: Vec<u32>,
    members: Vec<u32>,
}

impl Groups {
    pub fn new() -> Groups {
        Groups { start: vec![0], members: Vec::new() }
    }

    pub fn push(&mut self, members: impl IntoIterator<Item = u32>) {
        self.members.extend(members);
        self.start.push(self.members.len() as u32);
    }

    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        self.start.windows(2).map(|ends| &self.members[ends[0] as usize..ends[1] as usize])
    }

    pub fn par_iter(&self) -> impl IndexedParallelIterator<Item = &[u32]> {
        self.start.par_windows(2).map(|ends| &self.members[ends[0] as usize..ends[1] as usize])
    }
}

/// Mean colour of a patch.
pub(super) struct Colour {
    pub albedo: Vec3,
    pub emitted: Vec3,
}

/// Area, centroid and unit normal of a group.
fn shape(geometry: &Geometry, fragments: &Fragments, group: &[u32]) -> (f64, DVec3, DVec3) {
    let (mut area, mut centroid, mut normal) = (0.0, DVec3::ZERO, DVec3::ZERO);
    for &m in group {
        let f = (m >> 1) as usize;
        let corners = corners(geometry, fragments.triangle[f] as usize);
        // Degenerate dust still needs a place.
        let a = fragments.area(f, &corners).max(f64::MIN_POSITIVE);
        area += a;
        centroid += a * point_at(&corners, uv_centroid(fragments.uv(f))).as_dvec3();
        normal += a * if m & 1 == 1 { -normal_of(&corners) } else { normal_of(&corners) }.as_dvec3();
    }
    (area, centroid / area, normal.normalize_or_zero())
}

/// Mean albedo and emitted exitance of a group of members of the scene's own triangles, by area.
pub(super) fn mean_colour(scene: &Scene, fragments: &Fragments, group: &[u32]) -> Colour {
    let (mut area, mut albedo, mut emitted) = (0.0, DVec3::ZERO, DVec3::ZERO);
    for &m in group {
        let (f, side) = ((m >> 1) as usize, m & 1);
        let t = fragments.triangle[f] as usize;
        let a = fragments.area(f, &scene.corners_of(t)).max(f64::MIN_POSITIVE);
        area += a;
        albedo += a * mean_albedo(scene, fragments, f).as_dvec3();
        if side == 0 || scene.triangles[t].emits_back {
            emitted += a * std::f64::consts::PI * scene.emission(t).as_dvec3();
        }
    }
    Colour { albedo: (albedo / area).as_vec3(), emitted: (emitted / area).as_vec3() }
}

/// Mean albedo over fragment `f`: 8 stratified points on each triangle of its fan.
pub(super) fn mean_albedo(scene: &Scene, fragments: &Fragments, f: usize) -> Vec3 {
    let t = fragments.triangle[f] as usize;
    if let Some(albedo) = scene.constant_albedo(t) {
        return albedo;
    }
    let uv = fragments.uv(f);
    let (mut weight, mut sum) = (0.0, Vec3::ZERO);
    for w in uv[1..].windows(2) {
        let (e1, e2) = (w[0] - uv[0], w[1] - uv[0]);
        let area = e1.perp_dot(e2).max(f32::MIN_POSITIVE);
        for k in 0..8 {
            let (u, v) = crate::sampling::triangle((k % 4) as f32 / 4.0 + 0.125, (k / 4) as f32 / 2.0 + 0.25);
            let p = uv[0] + e1 * u + e2 * v;
            sum += area * scene.albedo(t, p.x, p.y);
            weight += area;
        }
    }
    sum / weight
}
