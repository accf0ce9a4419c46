//! Ray queries by the compressed wide BVH of obvhs: pure Rust, one ray at a time.
//!
//! obvhs gives the tree; the triangle test is the edge test of Embree's robust mode, so that both backends agree on which
//! side of a shared edge a ray passes.

use glam::{UVec2, Vec3, Vec3A};
use obvhs::{
    Boundable, BvhBuildParams,
    aabb::Aabb,
    bvh2::reinsertion::ReinsertionOptimizer,
    cwbvh::{CwBvh, bvh2_to_cwbvh::bvh2_to_cwbvh, node::CwBvhNode},
    ploc::PlocBuilder,
    traverse,
};

use multiversion::multiversion;

use super::{Geometry, Hit, RayBatch, RayTracer};
use crate::{Error, Result};

/// obvhs walks the tree with a stack of 32 entries, and needs at most one a level.
const DEEPEST: usize = 31;

/// A direction's component below 1 / this, relative to the largest one, counts as this slow in the box test.
const STEEPEST: f32 = (1u64 << 40) as f32;

/// A tree over triangles whose coordinates were scaled into [-2, 2] by a power of two, which is exact.
pub struct Bvh {
    tree: CwBvh,
    /// In the order of the leaves; `tree.primitive_indices` has their ids.
    triangles: Vec<[Vec3; 3]>,
    scale: f32,
}

/// A ray in the units of the tree.
struct Scaled {
    origin: Vec3A,
    /// The largest component is in [1, 2).
    direction: Vec3A,
    /// Distance of the caller = distance here * this power of two.
    to_caller: f32,
}

/// The bounds of a triangle, grown by more than the rounding error of the box test.
struct Grown(Aabb);

impl Boundable for Grown {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

impl Bvh {
    /// Builds the tree, on one thread: the same triangles give the same tree.
    ///
    /// # Errors
    /// [`Error::Backend`] if an index or a coordinate is invalid, or the tree is too deep for its stack (which takes
    /// hundreds of triangles that each are half as large as the one before).
    pub fn new(geometry: &Geometry) -> Result<Bvh> {
        geometry.check()?;
        let largest = geometry.positions.iter().fold(0.0f32, |m, p| m.max(p.abs().max_element()));
        let scale = if largest > 0.0 { power_of_two(-exponent(largest)) } else { 1.0 };
        let corner = |i: u32| geometry.positions[i as usize] * scale;
        let triangles: Vec<[Vec3; 3]> = geometry.triangles.iter().map(|t| t.map(corner)).collect();
        let tree = build_tree(&triangles);
        if depth(&tree) > DEEPEST {
            return Err(Error::Backend("the tree of the bvh backend is too deep; use --backend embree".into()));
        }
        let triangles = tree.primitive_indices.iter().map(|&i| triangles[i as usize]).collect();
        Ok(Bvh { tree, triangles, scale })
    }

    /// None for rays that cannot hit: not finite, or without a direction.
    fn scaled(&self, rays: &RayBatch, i: usize) -> Option<Scaled> {
        let (origin, direction) = (Vec3A::from(rays.origin(i)), Vec3A::from(rays.direction(i)));
        let largest = direction.abs().max_element();
        if !(origin.is_finite() && direction.is_finite() && largest >= f32::MIN_POSITIVE) {
            return None;
        }
        let e = exponent(largest);
        let shrink = power_of_two(-e);
        Some(Scaled { origin: origin * self.scale, direction: direction * shrink, to_caller: shrink / self.scale })
    }

    /// The nearest hit, or with `any` whichever is found first.
    #[inline(always)]
    fn trace(&self, rays: &RayBatch, i: usize, any: bool) -> Hit {
        let mut hit = Hit::NONE;
        let (t_min, mut t_max) = (rays.t_min[i], rays.t_max[i]);
        let Some(ray) = self.scaled(rays, i) else { return hit };
        if self.tree.nodes.is_empty() {
            return hit;
        }
        // Farther than the hit by more than rounding, so that equal distances are still looked at.
        let far = |t: f32| t / ray.to_caller * (1.0 + 4.0 * f32::EPSILON);
        let inverse = Vec3A::from_array(ray.direction.to_array().map(inverse));
        let mut farthest = far(t_max);
        let mut state = self.tree.new_traversal(ray.direction);
        let mut node;
        traverse!(self.tree, node, state, boxes(node, &ray, inverse, farthest, state.oct_inv4), {
            if let Some((t, u, v, back)) = ray.meets(&self.triangles[state.primitive_id as usize])
                && t > t_min
                && t < t_max
            {
                let id = self.tree.primitive_indices[state.primitive_id as usize];
                hit = Hit { t, u, v, face: id << 1 | back as u32 };
                if any {
                    return hit;
                }
                t_max = t;
                farthest = far(t);
            }
        });
        hit
    }
}

impl Scaled {
    /// (t in units of the caller, u, v, back side) by the signed volumes of the ray and the three edges.
    ///
    /// The two triangles at an edge compute its volume from the same numbers in reverse order and get exactly the
    /// opposite value, so no ray slips between them; in double precision, because in single precision some still
    /// slip through where several triangles meet in a vertex.
    /// Source: `triangle_intersector_pluecker.h` of Embree.
    #[inline(always)]
    fn meets(&self, triangle: &[Vec3; 3]) -> Option<(f32, f32, f32, bool)> {
        let d = self.direction.as_dvec3();
        let [a, b, c] = triangle.map(|p| p.as_dvec3() - self.origin.as_dvec3());
        let u = (c - a).cross(c + a).dot(d);
        let v = (a - b).cross(a + b).dot(d);
        let w = (b - c).cross(b + c).dot(d);
        if u.min(v).min(w) < 0.0 && u.max(v).max(w) > 0.0 {
            return None;
        }
        let sum = u + v + w;
        let normal = (b - a).cross(c - a);
        let facing = normal.dot(d);
        let t = (normal.dot(a) / facing) as f32 * self.to_caller;
        // A degenerate triangle, or one seen edge-on, gives a zero or something that is not finite.
        if sum == 0.0 || facing == 0.0 || !t.is_finite() {
            return None;
        }
        Some((t, (u / sum) as f32, (v / sum) as f32, facing > 0.0))
    }
}

/// Finite even for zero: a slab that the ray does not cross is then entered and left very far away.
fn inverse(d: f32) -> f32 {
    if d.abs() * STEEPEST >= 1.0 {
        1.0 / d
    } else if d < 0.0 {
        -STEEPEST
    } else {
        STEEPEST
    }
}

/// Which children of a node the ray meets before `farthest`, as bits for `traverse!`. All eight at once, without a
/// branch; the arithmetic is that of [`CwBvhNode::intersect_ray`], but for boxes that the ray starts in or at.
#[inline(always)]
fn boxes(node: &CwBvhNode, ray: &Scaled, inverse: Vec3A, farthest: f32, oct_inv4: u32) -> u32 {
    let scale = node.compute_extent() * inverse;
    let shift = (Vec3A::from(node.p) - ray.origin) * inverse;
    let (bits, places) = node.get_child_and_index_bits(oct_inv4);
    let (bits, places) = (bits.to_le_bytes(), places.to_le_bytes());
    let order = |down, low, high| if down { (high, low) } else { (low, high) };
    let (near_x, far_x) = order(ray.direction.x < 0.0, &node.child_min_x, &node.child_max_x);
    let (near_y, far_y) = order(ray.direction.y < 0.0, &node.child_min_y, &node.child_max_y);
    let (near_z, far_z) = order(ray.direction.z < 0.0, &node.child_min_z, &node.child_max_z);
    let larger = |a: f32, b: f32| if a > b { a } else { b };
    let smaller = |a: f32, b: f32| if a < b { a } else { b };
    let mut mask = 0;
    for k in 0..8 {
        let near = larger(near_x[k] as f32 * scale.x + shift.x, near_y[k] as f32 * scale.y + shift.y);
        let near = larger(near, larger(near_z[k] as f32 * scale.z + shift.z, 0.0));
        let far = smaller(far_x[k] as f32 * scale.x + shift.x, far_y[k] as f32 * scale.y + shift.y);
        let far = smaller(far, smaller(far_z[k] as f32 * scale.z + shift.z, farthest));
        mask |= if near <= far { (bits[k] as u32) << (places[k] & 31) } else { 0 };
    }
    mask
}

#[multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt+popcnt"))]
fn closest_hits(bvh: &Bvh, rays: &RayBatch, hits: &mut [Hit]) {
    for (i, hit) in hits.iter_mut().enumerate() {
        *hit = bvh.trace(rays, i, false);
    }
}

#[multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt+popcnt"))]
fn occluded(bvh: &Bvh, rays: &RayBatch, occluded: &mut [bool]) {
    for (i, occluded) in occluded.iter_mut().enumerate() {
        *occluded = bvh.trace(rays, i, true).is_hit();
    }
}

fn build_tree(triangles: &[[Vec3; 3]]) -> CwBvh {
    if triangles.is_empty() {
        return CwBvh::default();
    }
    // Coordinates are below 2 and rays start near them: 64 ulp of 1 are several times the rounding error. Where many
    // triangles are equal, the builder finds every neighbour equally near and makes a chain; unequal margins do away
    // with that (the factor takes the leading bits of multiples of the golden ratio).
    let grown = |(i, t): (usize, &[Vec3; 3])| {
        let uneven = (i as u32).wrapping_mul(0x9E37_79B9) as f32 / u32::MAX as f32;
        let margin = Vec3A::splat(64.0 * f32::EPSILON * (1.0 + uneven));
        let b = Aabb::from_points(&t.map(Vec3A::from));
        Grown(Aabb::new(b.min - margin, b.max + margin))
    };
    let boxes: Vec<Grown> = triangles.iter().enumerate().map(grown).collect();
    let params = BvhBuildParams::medium_build();
    let ids = (0..triangles.len() as u32).collect();
    let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
        params.ploc_search_distance,
        &boxes,
        ids,
        params.sort_precision,
        params.search_depth_threshold,
    );
    ReinsertionOptimizer::default().run(&mut binary, params.reinsertion_batch_ratio, None);
    bvh2_to_cwbvh(&binary, 3, true, false)
}

/// Levels of the tree below the root.
fn depth(tree: &CwBvh) -> usize {
    let mut deepest = 0;
    let mut open = if tree.nodes.is_empty() { vec![] } else { vec![(0, 0)] };
    while let Some((node, level)) = open.pop() {
        deepest = deepest.max(level);
        let node = &tree.nodes[node as usize];
        open.extend((0..node.imask.count_ones()).map(|k| (node.child_base_idx + k, level + 1)));
    }
    deepest
}

/// e with 2^e <= x < 2^(e+1), for normal x, kept so that 2^e and 2^-e are both normal.
fn exponent(x: f32) -> i32 {
    ((x.to_bits() >> 23) as i32 - 127).clamp(-125, 125)
}

fn power_of_two(e: i32) -> f32 {
    f32::from_bits(((e + 127) as u32) << 23)
}

impl RayTracer for Bvh {
    fn name(&self) -> String {
        "obvhs 0.4, cwbvh".into()
    }

    fn closest_hits(&self, rays: &RayBatch, hits: &mut [Hit]) {
        closest_hits(self, rays, hits);
    }

    fn occluded(&self, rays: &RayBatch, occluded: &mut [bool]) {
        self::occluded(self, rays, occluded);
    }
}
