//! Surfel patches: the pieces of real surface in a voxel, grouped by the way they face.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::{
    Fragments, Grid, HitMap, Patches, Simplified, clip,
    layers::Surfaces,
    patches::{Groups, mean_colour},
    straddle::{Separated, separate},
};
use crate::{Scene, trace::RayTracer};

/// Largest cosine between the normals of surfaces that count as unlike: only they hide points of one surface from each
/// other.
pub(crate) const UNLIKE: f32 = 0.7;

/// Voxels, and fragments, of a unit of parallel work.
const VOXELS: usize = 64;
const FRAGMENTS: usize = 4096;

/// Cuts the scene by the grid and groups the pieces: one patch for each voxel and side of like normals whose points
/// see each other. `tracer` holds the scene's own triangles.
pub fn surfels(scene: &Scene, grid: Grid, tracer: &dyn RayTracer) -> Simplified {
    let geometry = scene.geometry();
    let normals = scene.normals();
    let whole = clip(scene, &grid);

    let sides = sides_by_voxel(scene, &whole);
    let voxels: Vec<&[(u64, u32)]> = sides.chunk_by(|a, b| a.0 == b.0).collect();

    let separated: Vec<Separated> = voxels
        .par_chunks(VOXELS)
        .with_max_len(1)
        .map(|voxels| {
            let surfaces = Surfaces { geometry: &geometry, normals: &normals, fragments: &whole, tracer };
            let mut out = Separated::default();
            for voxel in voxels {
                let members: Vec<u32> = voxel.iter().map(|s| s.1).collect();
                let normal = |m: u32| side_normal(&normals, &whole, m);
                let clusters = cluster(&members, normal).into_iter().flat_map(|c| surfaces.layers(c)).collect();
                separate(&geometry, &normals, &whole, clusters, grid.voxel_size as f32, tracer, &mut out);
            }
            out
        })
        .collect();
    let (mut fragments, first) = pieces(&whole, &separated);
    let mut groups = Groups::new();
    for group in separated.iter().flat_map(Separated::groups) {
        groups.push(group.iter().map(|p| (first[(p.member >> 1) as usize] + p.piece) << 1 | (p.member & 1)));
    }

    let colours: Vec<_> = groups.par_iter().map(|group| mean_colour(scene, &fragments, group)).collect();
    let h = grid.voxel_size as f32;
    let mut patches = Patches::of_groups(&geometry, &mut fragments, groups, &colours, h);
    let surfaces = Surfaces { geometry: &geometry, normals: &normals, fragments: &fragments, tracer };
    patches.eye = (0..patches.len())
        .collect::<Vec<_>>()
        .par_chunks(1024)
        .flat_map_iter(|chunk| surfaces.eyes(chunk.iter().map(|&i| (patches.centroid[i], patches.members(i))), h))
        .collect();
    let hit_map = HitMap::new(&geometry, &fragments, &grid);
    Simplified { grid, geometry, fragments, patches, hit_map }
}

/// All fragments, where those that were cut give way to their pieces; and the number of each one's first piece.
fn pieces(whole: &Fragments, separated: &[Separated]) -> (Fragments, Vec<u32>) {
    let mut cuts: Vec<Option<&[Vec<Vec2>]>> = vec![None; whole.len()];
    for (f, pieces) in separated.iter().flat_map(|s| &s.cuts) {
        cuts[*f as usize] = Some(pieces);
    }
    let first = cuts.iter().scan(0, |next, cut| {
        let first = *next;
        *next += cut.map_or(1, <[_]>::len) as u32;
        Some(first)
    });
    let first = first.collect();
    let parts: Vec<Fragments> = cuts
        .par_chunks(FRAGMENTS)
        .enumerate()
        .map(|(k, cuts)| {
            let mut part = Fragments::default();
            for (f, cut) in (k * FRAGMENTS..).zip(cuts) {
                let (triangle, voxel) = (whole.triangle[f], whole.voxel[f]);
                match cut {
                    None => part.push(triangle, voxel, whole.uv(f).iter().copied()),
                    Some(pieces) => pieces.iter().for_each(|p| part.push(triangle, voxel, p.iter().copied())),
                }
            }
            part
        })
        .collect();
    (Fragments::join(&parts), first)
}

/// Gives patches the mean colours of `scene`, whose surfaces they are made of.
pub(crate) fn colour(simplified: &mut Simplified, scene: &Scene) {
    let Simplified { fragments, patches, .. } = simplified;
    let colours: Vec<_> =
        (0..patches.len()).into_par_iter().map(|i| mean_colour(scene, fragments, patches.members(i))).collect();
    patches.albedo = colours.iter().map(|c| c.albedo).collect();
    patches.emitted = colours.iter().map(|c| c.emitted).collect();
}

/// Every visible side of every fragment as (voxel, `fragment * 2 + side`), voxel by voxel.
fn sides_by_voxel(scene: &Scene, fragments: &Fragments) -> Vec<(u64, u32)> {
    let mut sides: Vec<(u64, u32)> = (0..fragments.len())
        .into_par_iter()
        .flat_map_iter(|f| {
            let two_sided = scene.triangles[fragments.triangle[f] as usize].two_sided;
            let voxel = fragments.voxel[f];
            (0..=two_sided as u32).map(move |side| (voxel, (f as u32) << 1 | side))
        })
        .collect();
    sides.par_sort_unstable();
    sides
}

/// Counts fragments and the fragments of each mesh, and estimates the number of patches.
pub fn count(scene: &Scene, grid: &Grid) -> (usize, usize, Vec<usize>) {
    let whole = clip(scene, grid);
    let normals = scene.normals();
    let sides = sides_by_voxel(scene, &whole);
    let voxels: Vec<&[(u64, u32)]> = sides.chunk_by(|a, b| a.0 == b.0).collect();
    let patches = voxels
        .par_iter()
        .map(|voxel| {
            let members: Vec<u32> = voxel.iter().map(|s| s.1).collect();
            let normal = |m: u32| side_normal(&normals, &whole, m);
            // Where unlike surfaces meet, about every second cluster is split in three.
            let meet = members.iter().any(|&m| normal(m).dot(normal(members[0])).abs() < UNLIKE);
            cluster(&members, normal).len() * if meet { 2 } else { 1 }
        })
        .sum();
    let mut by_mesh = vec![0; scene.meshes.len()];
    whole.triangle.iter().for_each(|&t| by_mesh[scene.triangles[t as usize].mesh as usize] += 1);
    (whole.len(), patches, by_mesh)
}

/// Unit normal of the side that `member` (`fragment * 2 + side`) names.
fn side_normal(normals: &[Vec3], fragments: &Fragments, member: u32) -> Vec3 {
    let n = normals[fragments.triangle[(member >> 1) as usize] as usize];
    if member & 1 == 1 { -n } else { n }
}

/// Groups members by signed dominant axis and likeness of their normals to the first of the group.
fn cluster(members: &[u32], normal: impl Fn(u32) -> Vec3) -> Vec<Vec<u32>> {
    let mut clusters: Vec<(u32, Vec3, Vec<u32>)> = Vec::new();
    for &m in members {
        let n = normal(m);
        let axis = dominant_axis(n);
        match clusters.iter_mut().find(|c| c.0 == axis && c.1.dot(n) > UNLIKE) {
            Some(c) => c.2.push(m),
            None => clusters.push((axis, n, vec![m])),
        }
    }
    clusters.into_iter().map(|c| c.2).collect()
}

/// Which of the six signed axes `n` points along most; ties go to the first.
fn dominant_axis(n: Vec3) -> u32 {
    let a = n.abs();
    let k = if a.x >= a.y && a.x >= a.z {
        0
    } else if a.y >= a.z {
        1
    } else {
        2
    };
    2 * k as u32 + (n[k] < 0.0) as u32
}
