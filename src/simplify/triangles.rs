//! Patches that are the triangles of a simplified mesh.

use std::collections::HashMap;

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::{
    Fragments, Grid, HitMap, NO_PATCH, Patches, Simplified, SplitMesh,
    feet::{Foot, feet},
    normal_of,
    patches::{Colour, Groups},
};
use crate::{
    Scene,
    sampling::triangle,
    scene::SurfacePoint,
    trace::{Geometry, RayTracer},
};

/// A simplified mesh.
#[derive(Debug, Default)]
pub(super) struct Mesh {
    pub positions: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    /// Whether the backs of the triangles are patches too.
    pub two_sided: Vec<bool>,
}

/// Longest edge of a patch, in units of the edge of a square that has the mean area of the patches: bisection then
/// makes patches of about that area.
const LONGEST: f32 = 2.35;
/// Points of a patch that ask the real surfaces for their colour, on each axis.
const SAMPLES: u32 = 4;

/// Makes every triangle of `mesh`, cut to about `size`, a patch. The real surfaces give them their colours.
pub(super) fn simplified(scene: &Scene, grid: Grid, mut mesh: Mesh, size: f32, tracer: &dyn RayTracer) -> Simplified {
    subdivide(&mut mesh, LONGEST * size);
    let corners = |t: usize| mesh.triangles[t].map(|v| mesh.positions[v as usize]);
    let voxel = |t: usize| grid.raster(grid.voxel_of(corners(t).iter().map(|p| p.as_dvec3()).sum::<DVec3>() / 3.0));
    let mut order: Vec<(u64, u32)> = (0..mesh.triangles.len()).map(|t| (voxel(t), t as u32)).collect();
    order.par_sort_unstable();

    let mut geometry = Geometry { positions: mesh.positions.clone(), triangles: Vec::with_capacity(order.len()) };
    let mut fragments = Fragments { start: vec![0].into(), ..Fragments::default() };
    let mut groups = Groups::new();
    for (k, &(voxel, t)) in order.iter().enumerate() {
        geometry.triangles.push(mesh.triangles[t as usize]);
        fragments.push(k as u32, voxel, [Vec2::ZERO, Vec2::X, Vec2::Y]);
        let sides = 1 + mesh.two_sided[t as usize] as u32;
        (0..sides).for_each(|side| groups.push([(k as u32) << 1 | side]));
    }
    let colours = colours(scene, &geometry, &groups.iter().collect::<Vec<_>>(), tracer);
    let patches = Patches::of_groups(&geometry, &mut fragments, groups, &colours, grid.voxel_size as f32);
    let hit_map = HitMap::new(&geometry, &fragments, &grid);
    Simplified { grid, geometry, fragments, patches, hit_map }
}

/// The triangles that are patches, one for each side that is one, as a mesh of its own.
pub fn patch_mesh(simplified: &Simplified) -> SplitMesh {
    let mut mesh = SplitMesh { positions: simplified.geometry.positions.clone(), ..SplitMesh::default() };
    for (t, &[a, b, c]) in simplified.geometry.triangles.iter().enumerate() {
        for (side, patch) in simplified.fragments.patch[t].into_iter().enumerate().filter(|(_, p)| *p != NO_PATCH) {
            mesh.triangles.push(if side == 1 { [a, c, b] } else { [a, b, c] });
            mesh.source.push(t as u32);
            mesh.patch.push(patch);
        }
    }
    mesh
}

/// Bisects the longest edges until none is longer than `longest`. An edge is cut if and only if it is too long, so that
/// triangles still share their edges.
pub(super) fn subdivide(mesh: &mut Mesh, longest: f32) {
    let mut middles: HashMap<(u32, u32), u32> = HashMap::new();
    let (mut done, mut sides) = (Vec::new(), Vec::new());
    let mut open: Vec<([u32; 3], bool)> = Vec::new();
    for (&t, &two_sided) in mesh.triangles.iter().zip(&mesh.two_sided) {
        open.push((t, two_sided));
        while let Some((t, two_sided)) = open.pop() {
            let length = |k: usize| {
                let [a, b] = [t[k], t[(k + 1) % 3]].map(|v| mesh.positions[v as usize]);
                a.distance_squared(b)
            };
            let k = (0..3).fold(0, |best, k| if length(k) > length(best) { k } else { best });
            let [a, b, c] = [t[k], t[(k + 1) % 3], t[(k + 2) % 3]];
            let (p, q) = (mesh.positions[a as usize], mesh.positions[b as usize]);
            let middle = 0.5 * (p + q);
            // Edges that rounding does not let shrink are done.
            if length(k) <= longest * longest || middle == p || middle == q {
                done.push(t);
                sides.push(two_sided);
                continue;
            }
            let m = *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                mesh.positions.push(middle);
                mesh.positions.len() as u32 - 1
            });
            open.extend([([m, b, c], two_sided), ([a, m, c], two_sided)]);
        }
    }
    mesh.triangles = done;
    mesh.two_sided = sides;
}

/// Stratified points of a triangle, on its front or back.
pub(super) fn points_of(corners: &[Vec3; 3], back: bool, side: u32) -> impl Iterator<Item = SurfacePoint> + use<> {
    let corners = *corners;
    let normal = if back { -normal_of(&corners) } else { normal_of(&corners) };
    let at = move |k: u32| (k as f32 + 0.5) / side as f32;
    (0..side * side).map(move |k| {
        let (u, v) = triangle(at(k % side), at(k / side));
        SurfacePoint { position: super::clip::point_at(&corners, Vec2::new(u, v)), normal }
    })
}

/// Gives patches the mean colours of the surfaces of `scene` that they stand for.
pub(super) fn colour(simplified: &mut Simplified, scene: &Scene, tracer: &dyn RayTracer) {
    let Simplified { geometry, patches, .. } = simplified;
    let groups: Vec<&[u32]> = (0..patches.len()).map(|i| patches.members(i)).collect();
    let colours = colours(scene, geometry, &groups, tracer);
    patches.albedo = colours.iter().map(|c| c.albedo).collect();
    patches.emitted = colours.iter().map(|c| c.emitted).collect();
}

/// Mean colours of the real surfaces that the patches stand for.
fn colours(scene: &Scene, geometry: &Geometry, groups: &[&[u32]], tracer: &dyn RayTracer) -> Vec<Colour> {
    let plain = mean_albedo(scene);
    let count = (SAMPLES * SAMPLES) as usize;
    groups
        .par_chunks(256)
        .flat_map_iter(|chunk| {
            let points: Vec<SurfacePoint> = chunk
                .iter()
                .flat_map(|group| {
                    points_of(&super::corners(geometry, (group[0] >> 1) as usize), group[0] & 1 == 1, SAMPLES)
                })
                .collect();
            let found = feet(scene, tracer, &points, false);
            found.chunks_exact(count).map(|feet| mean_colour(scene, feet, plain)).collect::<Vec<_>>()
        })
        .collect()
}

/// The mean over the feet of a patch; `plain` where there are none.
fn mean_colour(scene: &Scene, feet: &[Option<Foot>], plain: Vec3) -> Colour {
    let (mut albedo, mut emitted, mut found) = (DVec3::ZERO, DVec3::ZERO, 0.0);
    for foot in feet.iter().flatten() {
        let t = foot.hit.triangle();
        albedo += scene.albedo(t, foot.hit.u, foot.hit.v).as_dvec3();
        if !foot.back || scene.triangles[t].emits_back {
            emitted += std::f64::consts::PI * scene.emission(t).as_dvec3();
        }
        found += 1.0;
    }
    if found == 0.0 {
        return Colour { albedo: plain, emitted: Vec3::ZERO };
    }
    Colour { albedo: (albedo / found).as_vec3(), emitted: (emitted / found).as_vec3() }
}

/// Mean albedo of the scene, by area.
fn mean_albedo(scene: &Scene) -> Vec3 {
    let (mut area, mut sum) = (0.0, DVec3::ZERO);
    for t in 0..scene.triangles.len() {
        area += scene.area(t);
        sum += scene.area(t) * scene.albedo(t, 1.0 / 3.0, 1.0 / 3.0).as_dvec3();
    }
    (sum / area).as_vec3()
}

/// Area of all sides that receive light, local units.
pub(super) fn visible_area(scene: &Scene) -> f64 {
    (0..scene.triangles.len()).map(|t| scene.area(t) * (1 + scene.triangles[t].two_sided as u32) as f64).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn subdivision_keeps_area_and_leaves_no_crack() {
        let positions = vec![Vec3::ZERO, Vec3::X, Vec3::new(0.9, 1.3, 0.2), Vec3::new(-0.1, 0.4, 0.3)];
        let mut mesh = Mesh { positions, triangles: vec![[0, 1, 2], [0, 2, 3]], two_sided: vec![false, true] };
        let area = |mesh: &Mesh| -> f32 {
            let corners = mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize]));
            corners.map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length()).sum()
        };
        let before = area(&mesh);
        subdivide(&mut mesh, 0.2);
        assert!(mesh.triangles.len() > 60 && mesh.two_sided.len() == mesh.triangles.len());
        assert!((area(&mesh) / before - 1.0).abs() < 1e-5);
        let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
        for t in &mesh.triangles {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                assert!(mesh.positions[a as usize].distance(mesh.positions[b as usize]) <= 0.2);
                *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
            }
        }
        // Inner edges run both ways; the open ones are those of the square's border, all of them on it.
        let open: f32 = (edges.iter().filter(|e| *e.1 != 0))
            .map(|((a, b), _)| mesh.positions[*a as usize].distance(mesh.positions[*b as usize]))
            .sum();
        let corners = [0usize, 1, 2, 3].map(|v| mesh.positions[v]);
        let border: f32 = (0..4).map(|k| corners[k].distance(corners[(k + 1) % 4])).sum();
        assert!((open / border - 1.0).abs() < 1e-5, "{open} {border}");
    }
}
