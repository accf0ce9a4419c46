//! Layers: surfaces of one voxel that face alike, one above the other.
//!
//! The two sheets of a wall that is thinner than a voxel, a picture before its wall, a lamp's back under the ceiling: the
//! lower one sees nothing of what the upper one sees, so they are no patch together.

use glam::Vec3;

use super::{
    Fragments,
    clip::{depth_inside, point_at, uv_centroid, uv_of},
    corners,
};
use crate::{
    scene::RAY_OFFSET,
    trace::{Geometry, Hit, RayBatch, RayTracer},
};

/// Height, in voxels, at which points of a surface look for each other.
pub(crate) const LIFT: f32 = 0.02;

/// Surfaces and what is known of them.
pub(super) struct Surfaces<'a> {
    pub geometry: &'a Geometry,
    /// Normals of the triangles.
    pub normals: &'a [Vec3],
    pub fragments: &'a Fragments,
    pub tracer: &'a dyn RayTracer,
}

impl Surfaces<'_> {
    fn normal(&self, member: u32) -> Vec3 {
        let n = self.normals[self.fragments.triangle[(member >> 1) as usize] as usize];
        if member & 1 == 1 { -n } else { n }
    }

    fn corners(&self, member: u32) -> [Vec3; 3] {
        corners(self.geometry, self.fragments.triangle[(member >> 1) as usize] as usize)
    }

    fn centroid(&self, member: u32) -> Vec3 {
        point_at(&self.corners(member), uv_centroid(self.fragments.uv((member >> 1) as usize)))
    }

    /// Splits a cluster of members that face alike into its layers, the uppermost first.
    ///
    /// A member lies below others if a ray up from its middle meets anything up to the height of the highest: up from
    /// one smooth surface nothing of it stands, whether it is convex or hollow.
    pub fn layers(&self, cluster: Vec<u32>) -> Vec<Vec<u32>> {
        let up = self.normal(cluster[0]);
        let mut layers = Vec::new();
        let mut rest: Vec<(u32, Vec3)> = cluster.into_iter().map(|m| (m, self.centroid(m))).collect();
        loop {
            let heights = rest.iter().map(|(_, p)| p.dot(up));
            let (low, top) = heights.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, top), h| (low.min(h), top.max(h)));
            let mut covered = vec![false; rest.len()];
            if top - low > 2.0 * RAY_OFFSET {
                let mut rays = RayBatch::with_capacity(rest.len());
                for &(m, p) in &rest {
                    // A little farther than the top, to meet it.
                    rays.push(p + RAY_OFFSET * self.normal(m), up, 0.0, top - p.dot(up) + RAY_OFFSET);
                }
                self.tracer.occluded(&rays, &mut covered);
            }
            let mut is_covered = covered.into_iter();
            let (below, above): (Vec<_>, Vec<_>) = rest.into_iter().partition(|_| is_covered.next() == Some(true));
            if above.is_empty() || below.is_empty() {
                layers.push(if above.is_empty() { below } else { above }.into_iter().map(|(m, _)| m).collect());
                return layers;
            }
            layers.push(above.into_iter().map(|(m, _)| m).collect());
            rest = below;
        }
    }

    /// From where each of some patches, given by their centroids and members, looks at its neighbours: a point of its
    /// surface near its centroid, lifted, but not above what may stand close over it.
    pub fn eyes<'m>(&self, patches: impl Iterator<Item = (Vec3, &'m [u32])>, voxel_size: f32) -> Vec<Vec3> {
        let feet: Vec<(Vec3, Vec3)> = patches.map(|(centroid, members)| self.foot(centroid, members)).collect();
        let lift = LIFT * voxel_size;
        let heights = clear_heights(self.tracer, feet.iter().copied(), lift);
        feet.iter().zip(heights).map(|((p, n), height)| p + height * n).collect()
    }

    /// The point of the surface at the centroid, or the middle of the nearest member; with its normal.
    fn foot(&self, centroid: Vec3, members: &[u32]) -> (Vec3, Vec3) {
        let holds = |m: u32| {
            let (triangle, uv) = (self.corners(m), self.fragments.uv((m >> 1) as usize));
            let at = uv_of(&triangle, centroid);
            (depth_inside(uv, at) >= 0.0).then(|| (point_at(&triangle, at), self.normal(m)))
        };
        let nearest = || {
            let distance = |m: &u32| self.centroid(*m).distance_squared(centroid);
            let m = members.iter().copied().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or_default();
            (self.centroid(m), self.normal(m))
        };
        members.iter().find_map(|&m| holds(m)).unwrap_or_else(nearest)
    }
}

/// How far points (position, unit normal) can be lifted off their surfaces: by `lift`, or half the way to what stands
/// closer over them.
pub(crate) fn clear_heights(tracer: &dyn RayTracer, points: impl Iterator<Item = (Vec3, Vec3)>, lift: f32) -> Vec<f32> {
    let mut rays = RayBatch::default();
    points.for_each(|(p, n)| rays.push(p + RAY_OFFSET * n, n, 0.0, lift));
    let mut hits = vec![Hit::NONE; rays.len()];
    tracer.closest_hits(&rays, &mut hits);
    hits.iter().map(|hit| if hit.is_hit() { RAY_OFFSET + 0.5 * hit.t } else { lift }).collect()
}
