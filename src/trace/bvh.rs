//! Ray queries by an eight-wide tree: pure Rust, one ray at a time.
//!
//! obvhs decides on the tree; the triangle test is the edge test of Embree's robust mode, so that both backends agree on
//! which side of a shared edge a ray passes.

use glam::{DVec3, Vec3, Vec3A};
use obvhs::{
    Boundable, BvhBuildParams,
    aabb::Aabb,
    bvh2::reinsertion::ReinsertionOptimizer,
    cwbvh::{CwBvh, bvh2_to_cwbvh::bvh2_to_cwbvh},
    ploc::PlocBuilder,
};

use multiversion::multiversion;

use super::{
    Geometry, Hit, RayBatch, RayTracer,
    wide::{Child, Inside, LANES, MOST_TRIANGLES, Node, Slabs, widen},
};
use crate::{Error, Result};

/// Levels below the root that trees may have.
const DEEPEST: usize = 31;

/// What is still to be visited, with its distance. Every level leaves at most all boxes of a node but one.
type Stack = [(Child, f32); STACK];
const STACK: usize = (DEEPEST + 1) * (LANES - 1);

/// Boxes are grown by this, in units of the tree. Coordinates are below 2 and rays start near them: 64 ulp of 1 are several
/// times the rounding error of the box test.
const MARGIN: f32 = 64.0 * f32::EPSILON;

/// Share of the nodes that the builder looks for a better place for. On a scene of 210,000 triangles: 0.05 builds in 0.11 s
/// and a ray takes 1.06 times as long; 1 takes 0.58 instead of 0.16 s and gains nothing.
const REINSERTED: f32 = 0.2;

/// A direction's component below 1 / this, relative to the largest one, counts as this slow in the box test.
const STEEPEST: f32 = (1u64 << 40) as f32;

/// A tree over triangles whose coordinates were scaled into [-2, 2] by a power of two, which is exact.
pub struct Bvh {
    nodes: Vec<Node>,
    /// In the order of the leaves.
    triangles: Vec<Corners>,
    /// Of the triangles.
    ids: Vec<u32>,
    scale: f32,
}

/// x, y and z of a triangle's corners and, to fill a vector, of the last one again.
type Corners = [[f32; 4]; 3];

/// A ray in the units of the tree.
struct Scaled {
    origin: Vec3A,
    /// The largest component is in [1, 2).
    direction: Vec3A,
    /// Distance of the caller = distance here * this power of two.
    to_caller: f32,
}

/// The bounds of a triangle, grown by [`MARGIN`] or more.
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
    /// [`Error::Backend`] if an index or a coordinate is invalid, there are more than 2^29 triangles, or the tree is too deep for its stack (which takes
    /// hundreds of triangles that each are half as large as the one before).
    pub fn new(geometry: &Geometry) -> Result<Bvh> {
        geometry.check()?;
        if geometry.triangles.len() > MOST_TRIANGLES {
            let n = geometry.triangles.len();
            return Err(Error::Backend(format!("the bvh backend holds at most {MOST_TRIANGLES} triangles, not {n}")));
        }
        let largest = geometry.positions.iter().fold(0.0f32, |m, p| m.max(p.abs().max_element()));
        let scale = if largest > 0.0 { power_of_two(-exponent(largest)) } else { 1.0 };
        let corner = |i: u32| geometry.positions[i as usize] * scale;
        let triangles: Vec<[Vec3; 3]> = geometry.triangles.iter().map(|t| t.map(corner)).collect();
        let tree = build_tree(&triangles);
        if depth(&tree) > DEEPEST {
            return Err(Error::Backend("the tree of the bvh backend is too deep; use --backend embree".into()));
        }
        let triangles: Vec<[Vec3; 3]> = tree.primitive_indices.iter().map(|&i| triangles[i as usize]).collect();
        let nodes = widen(&tree, &triangles, MARGIN);
        let by_axis = |[a, b, c]: &[Vec3; 3]| [0, 1, 2].map(|axis| [a[axis], b[axis], c[axis], c[axis]]);
        let triangles = triangles.iter().map(by_axis).collect();
        Ok(Bvh { nodes, triangles, ids: tree.primitive_indices, scale })
    }

    /// None for rays that cannot hit: not finite, or without a direction.
    #[inline(always)]
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

    /// The nearest hit, or with `any` whichever is found first. `stack` is working memory.
    #[inline(always)]
    fn trace(&self, rays: &RayBatch, i: usize, any: bool, stack: &mut Stack) -> Hit {
        let mut hit = Hit::NONE;
        let (t_min, mut t_max) = (rays.t_min[i], rays.t_max[i]);
        let Some(ray) = self.scaled(rays, i) else { return hit };
        if self.nodes.is_empty() {
            return hit;
        }
        // Farther than the hit by more than rounding, so that equal distances are still looked at.
        let far = |t: f32| t / ray.to_caller * (1.0 + 4.0 * f32::EPSILON);
        let slabs = Slabs::new(ray.origin, ray.direction, Vec3A::from_array(ray.direction.to_array().map(inverse)));
        let mut farthest = far(t_max);
        let mut height = 0;
        let mut next = Child::ROOT;
        loop {
            match next.inside() {
                Inside::Node(node) => {
                    let mut met = self.nodes[node].meets(&slabs, farthest);
                    if let Some(mut nearest) = met.next() {
                        let others = height;
                        for mut other in met {
                            if other.1 < nearest.1 {
                                std::mem::swap(&mut other, &mut nearest);
                            }
                            // The nearer, the higher. Any hit will do for `any`, so its boxes are not sorted.
                            let mut place = height;
                            while !any && place > others && stack[place - 1].1 < other.1 {
                                stack[place] = stack[place - 1];
                                place -= 1;
                            }
                            stack[place] = other;
                            height += 1;
                        }
                        next = nearest.0;
                        continue;
                    }
                }
                Inside::Triangles(range) => {
                    for (triangle, id) in self.triangles[range.clone()].iter().zip(&self.ids[range]) {
                        if let Some((t, u, v, back)) = ray.meets(triangle)
                            && t > t_min
                            && t < t_max
                        {
                            hit = Hit { t, u, v, face: id << 1 | back as u32 };
                            if any {
                                return hit;
                            }
                            t_max = t;
                            farthest = far(t);
                        }
                    }
                }
            }
            loop {
                if height == 0 {
                    return hit;
                }
                height -= 1;
                let (child, near) = stack[height];
                if near <= farthest {
                    next = child;
                    break;
                }
            }
        }
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
    fn meets(&self, triangle: &Corners) -> Option<(f32, f32, f32, bool)> {
        let (d, origin) = (self.direction.as_dvec3(), self.origin.as_dvec3());
        let [x, y, z] = [from(&triangle[0], origin.x), from(&triangle[1], origin.y), from(&triangle[2], origin.z)];
        // Corners c, a, b beside a, b, c: the three edges at once.
        let before = |p: [f64; 4]| [p[2], p[0], p[1], p[3]];
        let [x0, y0, z0] = [before(x), before(y), before(z)];
        let mut volumes = [0.0; 4];
        for (k, volume) in volumes.iter_mut().enumerate() {
            let edge = DVec3::new(x0[k] - x[k], y0[k] - y[k], z0[k] - z[k]);
            let sum = DVec3::new(x0[k] + x[k], y0[k] + y[k], z0[k] + z[k]);
            *volume = edge.cross(sum).dot(d);
        }
        let [u, v, w, _] = volumes;
        if u.min(v).min(w) < 0.0 && u.max(v).max(w) > 0.0 {
            return None;
        }
        let [a, b, c] = [0, 1, 2].map(|k| DVec3::new(x[k], y[k], z[k]));
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

/// Coordinates from an origin.
#[inline(always)]
fn from(coordinates: &[f32; 4], origin: f64) -> [f64; 4] {
    let mut relative = [0.0; 4];
    for k in 0..4 {
        relative[k] = coordinates[k] as f64 - origin;
    }
    relative
}

#[multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt+popcnt"))]
fn closest_hits(bvh: &Bvh, rays: &RayBatch, hits: &mut [Hit]) {
    let mut stack = [(Child::ROOT, 0.0); STACK];
    for (i, hit) in hits.iter_mut().enumerate() {
        *hit = bvh.trace(rays, i, false, &mut stack);
    }
}

#[multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt+popcnt"))]
fn occluded(bvh: &Bvh, rays: &RayBatch, occluded: &mut [bool]) {
    let mut stack = [(Child::ROOT, 0.0); STACK];
    for (i, occluded) in occluded.iter_mut().enumerate() {
        *occluded = bvh.trace(rays, i, true, &mut stack).is_hit();
    }
}

fn build_tree(triangles: &[[Vec3; 3]]) -> CwBvh {
    if triangles.is_empty() {
        return CwBvh::default();
    }
    // Where many triangles are equal, the builder finds every neighbour equally near and makes a chain; unequal margins do
    // away with that (the factor takes the leading bits of multiples of the golden ratio).
    let grown = |(i, t): (usize, &[Vec3; 3])| {
        let uneven = (i as u32).wrapping_mul(0x9E37_79B9) as f32 / u32::MAX as f32;
        let margin = Vec3A::splat(MARGIN * (1.0 + uneven));
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
    ReinsertionOptimizer::default().run(&mut binary, REINSERTED, None);
    bvh2_to_cwbvh(&binary, 3, false, true)
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
        "obvhs 0.4, 8-wide".into()
    }

    fn closest_hits(&self, rays: &RayBatch, hits: &mut [Hit]) {
        closest_hits(self, rays, hits);
    }

    fn occluded(&self, rays: &RayBatch, occluded: &mut [bool]) {
        self::occluded(self, rays, occluded);
    }
}
