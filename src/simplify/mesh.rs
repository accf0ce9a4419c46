//! The voxel-split mesh: what light is finally told at.

use std::{
    collections::{HashMap, HashSet},
    hash::{BuildHasher, Hasher},
};

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::{
    Fragments,
    clip::{point_at, uv_centroid},
    normal_of,
    surfels::UNLIKE,
    weld::{self, BuildFast, weld},
};
use crate::{
    Scene,
    scene::SurfacePoint,
    trace::{Hit, RayBatch, RayTracer},
};

/// The surfaces cut by the voxels, as a triangle mesh. Corners of equal position and normal that see each other are
/// one vertex, whatever mesh or triangle they come from: no seams. A vertex under a wall is two.
#[derive(Clone, Debug, Default)]
pub struct SplitMesh {
    /// Vertex positions, local.
    pub positions: Vec<Vec3>,
    /// Unit shading normals.
    pub normals: Vec<Vec3>,
    /// Albedo at the vertices.
    pub albedo: Vec<Vec3>,
    /// Vertex indices. Two-sided surfaces appear once for each side that light reaches.
    pub triangles: Vec<[u32; 3]>,
    /// Scene triangle that each triangle is a piece of.
    pub source: Vec<u32>,
    /// Patch that each triangle belongs to ([`super::NO_PATCH`] for `PatchSource::Faces`).
    pub patch: Vec<u32>,
    /// Where light is computed for each vertex: its position, moved slightly into the surfaces around it, because
    /// in the very corner of a room half of all rays would slip behind the walls.
    pub samples: Vec<SurfacePoint>,
}

impl SplitMesh {
    /// Albedo at the vertices anew: the materials of `scene` have changed.
    pub fn recolour(&mut self, scene: &Scene) {
        let mut sums = vec![(Vec3::ZERO, 0.0_f32); self.positions.len()];
        for (triangle, &source) in self.triangles.iter().zip(&self.source) {
            let corners = scene.corners_of(source as usize);
            for &v in triangle {
                let (u, w) = barycentric(&corners, self.positions[v as usize]);
                let sum = &mut sums[v as usize];
                sum.0 += scene.albedo(source as usize, u, w);
                sum.1 += 1.0;
            }
        }
        self.albedo = sums.iter().map(|(albedo, count)| albedo / count.max(1.0)).collect();
    }
}

/// Barycentric weights of the second and third corner of a triangle at `p` in its plane, within it.
fn barycentric([a, b, c]: &[Vec3; 3], p: Vec3) -> (f32, f32) {
    let (a, b, c, p) = (a.as_dvec3(), b.as_dvec3(), c.as_dvec3(), p.as_dvec3());
    let normal = (b - a).cross(c - a);
    let share = |edge: glam::DVec3, to: glam::DVec3| edge.cross(to).dot(normal) / normal.length_squared();
    let (u, v) = (share(p - a, c - a).clamp(0.0, 1.0), share(b - a, p - a).clamp(0.0, 1.0));
    (u as f32, v as f32)
}

/// A corner of a fragment's side.
#[derive(Clone, Copy, Default)]
struct Corner {
    position: Vec3,
    normal: Vec3,
    /// Geometric normal.
    flat: Vec3,
    albedo: Vec3,
    /// A point slightly inside the fragment, lifted off it.
    inside: Vec3,
}

/// Share of the way to the fragment's centre that sample points are moved.
const NUDGE: f32 = 0.02;

/// Triangulates the fragments' sides that `wanted` names (fragment, side), and welds their corners.
pub fn split_mesh(
    scene: &Scene,
    fragments: &Fragments,
    voxel_size: f32,
    tracer: &dyn RayTracer,
    wanted: impl Fn(usize, usize) -> bool + Sync,
) -> SplitMesh {
    let sides: Vec<(usize, usize)> =
        (0..fragments.len()).flat_map(|f| [(f, 0), (f, 1)]).filter(|&(f, side)| wanted(f, side)).collect();
    let corners = all_corners(scene, fragments, &sides);
    let (shared, count) = weld(&corners, |c| (c.position, c.normal));
    let vertex_of = separate(&corners, shared, count, voxel_size, scene, tracer);

    let mut mesh = SplitMesh::default();
    let vertices = vertex_of.iter().max().map_or(0, |v| *v as usize + 1);
    let mut sums = vec![(Vec3::ZERO, Vec3::ZERO, 0.0_f32); vertices];
    mesh.positions = vec![Vec3::ZERO; vertices];
    mesh.normals = vec![Vec3::ZERO; vertices];
    for (corner, &v) in corners.iter().zip(&vertex_of) {
        let v = v as usize;
        if sums[v].2 == 0.0 {
            mesh.positions[v] = corner.position;
            mesh.normals[v] = corner.normal;
        }
        let sum = &mut sums[v];
        sum.0 += corner.inside - corner.position;
        sum.1 += corner.albedo;
        sum.2 += 1.0;
    }
    // The largest array makes room before others come.
    drop(corners);
    mesh.albedo = sums.iter().map(|s| s.1 / s.2).collect();
    mesh.samples = (0..vertices)
        .map(|v| SurfacePoint { position: mesh.positions[v] + sums[v].0 / sums[v].2, normal: mesh.normals[v] })
        .collect();
    drop(sums);
    let count = vertex_of.len() - 2 * sides.len();
    mesh.triangles.reserve_exact(count);
    mesh.source.reserve_exact(count);
    mesh.patch.reserve_exact(count);
    let mut first = 0;
    for &(f, side) in &sides {
        let n = fragments.uv(f).len() as u32;
        for k in 1..n - 1 {
            mesh.triangles.push([0, k, k + 1].map(|c| vertex_of[(first + c) as usize]));
            mesh.source.push(fragments.triangle[f]);
            mesh.patch.push(fragments.patch[f][side]);
        }
        first += n;
    }
    mesh
}

/// Corners of all sides, in their order. They are written to their places at once: they are the largest thing that a bake
/// holds, and a second copy would be its peak of memory.
fn all_corners(scene: &Scene, fragments: &Fragments, sides: &[(usize, usize)]) -> Vec<Corner> {
    let count = |sides: &[(usize, usize)]| sides.iter().map(|&(f, _)| fragments.uv(f).len()).sum::<usize>();
    let mut corners = vec![Corner::default(); count(sides)];
    let mut rest = &mut corners[..];
    let mut parts = Vec::new();
    for chunk in sides.chunks(1024) {
        let (part, others) = std::mem::take(&mut rest).split_at_mut(count(chunk));
        parts.push((chunk, part));
        rest = others;
    }
    parts.into_par_iter().for_each(|(chunk, part)| {
        let made = chunk.iter().flat_map(|&(f, side)| fragment_corners(scene, fragments, f, side));
        part.iter_mut().zip(made).for_each(|(place, corner)| *place = corner);
    });
    corners
}

/// Corners of one side; those of the back run the other way round.
fn fragment_corners(scene: &Scene, fragments: &Fragments, f: usize, side: usize) -> Vec<Corner> {
    let t = fragments.triangle[f] as usize;
    let triangle = scene.corners_of(t);
    let flat = sign_of(side) * normal_of(&triangle);
    let uv = fragments.uv(f);
    let middle = point_at(&triangle, uv_centroid(uv));
    let mut corners: Vec<Corner> = uv
        .iter()
        .map(|&p| {
            let position = point_at(&triangle, p);
            Corner {
                position,
                normal: shading_normal(scene, t, side, flat, p),
                flat,
                albedo: scene.albedo(t, p.x, p.y),
                inside: position + NUDGE * (middle - position),
            }
        })
        .collect();
    if side == 1 {
        corners.reverse();
    }
    corners
}

/// 1 for the front, -1 for the back.
fn sign_of(side: usize) -> f32 {
    if side == 1 { -1.0 } else { 1.0 }
}

/// Normal of a side of triangle `t` at the place `p`; `flat` is its geometric one.
fn shading_normal(scene: &Scene, t: usize, side: usize, flat: Vec3, p: Vec2) -> Vec3 {
    let Some([a, b, c]) = scene.corners.normals.get(t) else { return flat };
    let n = (sign_of(side) * (*a * (1.0 - p.x - p.y) + *b * p.x + *c * p.y)).normalize_or_zero();
    if n.dot(flat) > 0.0 { n } else { flat }
}

/// One place in so many is looked at to foresee the number of vertices.
const SAMPLED: u64 = 16;

/// How many corners a split mesh will have, and about how many vertices: places and normals of a sixteenth of them are
/// told apart, without those that lie under a wall.
pub(crate) fn foresee(
    scene: &Scene,
    fragments: &Fragments,
    wanted: impl Fn(usize, usize) -> bool + Sync,
) -> (usize, usize) {
    let mut corners = 0;
    let mut places: HashSet<[i32; 6], BuildFast> = HashSet::default();
    for f in 0..fragments.len() {
        let t = fragments.triangle[f] as usize;
        let triangle = scene.corners_of(t);
        for side in (0..2).filter(|&side| wanted(f, side)) {
            let flat = sign_of(side) * normal_of(&triangle);
            corners += fragments.uv(f).len();
            for &p in fragments.uv(f) {
                let place = weld::place(point_at(&triangle, p));
                let mut hash = BuildFast::default().build_hasher();
                place.iter().for_each(|&x| hash.write_i32(x));
                if hash.finish() % SAMPLED == 0 {
                    let [x, y, z] = (shading_normal(scene, t, side, flat, p) * 50.0).round().as_ivec3().to_array();
                    places.insert([place[0], place[1], place[2], x, y, z]);
                }
            }
        }
    }
    (corners, places.len() * SAMPLED as usize)
}

/// Splits vertices whose corners do not see each other; returns the final vertex of every corner.
fn separate(
    corners: &[Corner],
    mut shared: Vec<u32>,
    count: usize,
    voxel_size: f32,
    scene: &Scene,
    tracer: &dyn RayTracer,
) -> Vec<u32> {
    let lift = 0.005 * voxel_size;
    let eye = |c: &Corner| c.inside + lift * c.flat;
    let normals = scene.normals();
    let blocked = |from: &[u32], to: &[u32]| -> Vec<bool> {
        from.par_chunks(4096)
            .zip(to.par_chunks(4096))
            .flat_map_iter(|(from, to)| {
                let mut rays = RayBatch::with_capacity(from.len());
                for (&a, &b) in from.iter().zip(to) {
                    let (p, q) = (eye(&corners[a as usize]), eye(&corners[b as usize]));
                    rays.push(p, q - p, 0.0, 1.0);
                }
                let mut hits = vec![Hit::NONE; rays.len()];
                tracer.closest_hits(&rays, &mut hits);
                let flat = |a: u32| corners[a as usize].flat;
                hits.iter()
                    .zip(from)
                    .map(|(h, &a)| h.is_hit() && normals[h.triangle()].dot(flat(a)).abs() < UNLIKE)
                    .collect::<Vec<_>>()
            })
            .collect()
    };
    // Each round compares the corners that still share a vertex with the first of them; those that do not see it
    // leave together for a new vertex. Three rounds part four rooms that meet in a point.
    let mut next = count as u32;
    let mut open: Vec<u32> = (0..corners.len() as u32).collect();
    for _ in 0..3 {
        let mut first = vec![u32::MAX; next as usize];
        let (mut from, mut to) = (Vec::new(), Vec::new());
        for &c in &open {
            let leader = &mut first[shared[c as usize] as usize];
            if *leader == u32::MAX {
                *leader = c;
            } else {
                from.push(*leader);
                to.push(c);
            }
        }
        let mut moved: HashMap<u32, u32, BuildFast> = HashMap::default();
        open.clear();
        for (hidden, &c) in blocked(&from, &to).into_iter().zip(&to) {
            if hidden {
                let vertex = shared[c as usize];
                shared[c as usize] = *moved.entry(vertex).or_insert_with(|| {
                    next += 1;
                    next - 1
                });
                open.push(c);
            }
        }
        if open.is_empty() {
            break;
        }
    }
    shared
}
