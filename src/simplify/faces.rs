//! The paper's patches, to the letter: equal square voxel faces (steps 2-4).

use glam::{DVec3, Vec2, Vec3};

use super::{
    Fragments, Grid, HitMap, Patches, Simplified, clip,
    clip::point_at,
    normal_of,
    patches::{Colour, Groups, mean_albedo},
};
use crate::{Scene, options::FaceColour, trace::Geometry};

/// Takes the faces between voxels with and without a surface, drops those inside objects, and colours the rest by
/// the polygons of their voxel, weighted by the area of their projection on the face.
///
/// A face lies inside or behind an object where the nearest polygon of its voxel turns its back to it. Since there is
/// no surface beyond the face, all of it lies on one side, and nothing stands between it and that polygon.
pub fn faces(scene: &Scene, grid: Grid, rule: FaceColour) -> Simplified {
    let pieces = clip(scene, &grid);
    let mut by_voxel: Vec<(u64, u32)> = (0..pieces.len()).map(|f| (pieces.voxel[f], f as u32)).collect();
    by_voxel.sort_unstable();
    let voxels: Vec<&[(u64, u32)]> = by_voxel.chunk_by(|a, b| a.0 == b.0).collect();
    let occupied = |voxel: [u32; 3]| voxels.binary_search_by_key(&grid.raster(voxel), |v| v[0].0).is_ok();

    let mut geometry = Geometry::default();
    let mut fragments = Fragments { start: vec![0].into(), ..Fragments::default() };
    let mut groups = Groups::new();
    let mut colours: Vec<Colour> = Vec::new();
    for members in &voxels {
        let voxel = grid.voxel_at(members[0].0);
        for axis in 0..3 {
            for up in [false, true] {
                let neighbour = step(voxel, axis, up, &grid);
                if neighbour.is_some_and(occupied) {
                    continue;
                }
                let mut outward = DVec3::ZERO;
                outward[axis] = if up { 1.0 } else { -1.0 };
                let centre = grid.centre(voxel) + 0.5 * grid.voxel_size * outward;
                let Some(colour) = face_colour(scene, &pieces, members, centre, outward, grid.voxel_size, rule) else {
                    continue;
                };
                let first = fragments.len() as u32;
                add_square(&grid, voxel, axis, up, members[0].0, &mut geometry, &mut fragments);
                groups.push([first << 1, (first + 1) << 1]);
                colours.push(colour);
            }
        }
    }
    let patches = Patches::of_groups(&geometry, &mut fragments, groups, &colours, grid.voxel_size as f32);
    let hit_map = HitMap::new(&geometry, &fragments, &grid);
    Simplified { grid, geometry, fragments, patches, hit_map }
}

/// The neighbour of `voxel`, unless outside the grid.
fn step(voxel: [u32; 3], axis: usize, up: bool, grid: &Grid) -> Option<[u32; 3]> {
    let mut neighbour = voxel;
    neighbour[axis] = if up { voxel[axis] + 1 } else { voxel[axis].checked_sub(1)? };
    (neighbour[axis] < grid.dims[axis]).then_some(neighbour)
}

/// Colour of the face of a voxel; `None` inside an object.
fn face_colour(
    scene: &Scene,
    pieces: &Fragments,
    members: &[(u64, u32)],
    centre: DVec3,
    outward: DVec3,
    voxel_size: f64,
    rule: FaceColour,
) -> Option<Colour> {
    if behind(scene, pieces, members, centre, voxel_size) {
        return None;
    }
    let (mut facing, mut albedo, mut emitted) = (0.0, DVec3::ZERO, DVec3::ZERO);
    let (mut whole, mut plain_albedo) = (0.0, DVec3::ZERO);
    for &(_, f) in members {
        let t = pieces.triangle[f as usize] as usize;
        let triangle = &scene.triangles[t];
        let corners = scene.corners_of(t);
        let area = pieces.area(f as usize, &corners);
        let cosine = normal_of(&corners).as_dvec3().dot(outward);
        let own = mean_albedo(scene, pieces, f as usize).as_dvec3();
        whole += area;
        plain_albedo += area * own;
        if cosine.abs() * area < 1e-6 * voxel_size * voxel_size {
            continue;
        }
        if cosine > 0.0 || triangle.two_sided {
            let projected = area * cosine.abs();
            facing += projected;
            albedo += projected * own;
            if cosine > 0.0 || triangle.emits_back {
                emitted += projected * std::f64::consts::PI * scene.emission(t).as_dvec3();
            }
        }
    }
    if facing > 0.0 {
        let norm = match rule {
            FaceColour::Normalised => facing,
            FaceColour::Literal => voxel_size * voxel_size,
        };
        let most = DVec3::splat(crate::scene::material::ALBEDO_MAX as f64);
        return Some(Colour { albedo: (albedo / norm).min(most).as_vec3(), emitted: (emitted / norm).as_vec3() });
    }
    // Polygons that are edge-on or turned away, but leave the face outside: the plain mean.
    Some(Colour { albedo: (plain_albedo / whole).as_vec3(), emitted: Vec3::ZERO })
}

/// Whether the polygon nearest to `p` turns its back to it. Of polygons that meet in the nearest point, the sum of
/// their normals decides, as Baerentzen & Aanaes 2005 show.
fn behind(scene: &Scene, pieces: &Fragments, members: &[(u64, u32)], p: DVec3, voxel_size: f64) -> bool {
    let nearest: Vec<(f64, DVec3, usize)> = members
        .iter()
        .map(|&(_, f)| {
            let t = pieces.triangle[f as usize] as usize;
            let corners = scene.corners_of(t);
            let polygon: Vec<DVec3> =
                pieces.uv(f as usize).iter().map(|&uv| point_at(&corners, uv).as_dvec3()).collect();
            let to = p - nearest_point(&polygon, normal_of(&corners).as_dvec3(), p);
            (to.length(), to, t)
        })
        .collect();
    let distance = nearest.iter().map(|n| n.0).fold(f64::INFINITY, f64::min);
    let mut normals: Vec<DVec3> = Vec::new();
    let (mut to_p, mut two_sided) = (DVec3::ZERO, false);
    for &(_, to, t) in nearest.iter().filter(|n| n.0 <= distance + 1e-4 * voxel_size) {
        let normal = normal_of(&scene.corners_of(t)).as_dvec3();
        to_p += to;
        two_sided |= scene.triangles[t].two_sided;
        if normals.iter().all(|n| n.dot(normal) < 0.9999) {
            normals.push(normal);
        }
    }
    !two_sided && normals.iter().sum::<DVec3>().dot(to_p) < 0.0
}

/// The point of a convex polygon that is nearest to `p`.
fn nearest_point(polygon: &[DVec3], normal: DVec3, p: DVec3) -> DVec3 {
    let edges = || (0..polygon.len()).map(|i| (polygon[i], polygon[(i + 1) % polygon.len()]));
    if edges().all(|(a, b)| (b - a).cross(p - a).dot(normal) >= 0.0) {
        return p - (p - polygon[0]).dot(normal) * normal;
    }
    let on_edges = edges().map(|(a, b)| {
        let along = (p - a).dot(b - a) / (b - a).length_squared().max(f64::MIN_POSITIVE);
        a.lerp(b, along.clamp(0.0, 1.0))
    });
    on_edges.min_by(|a, b| a.distance_squared(p).total_cmp(&b.distance_squared(p))).unwrap_or(p)
}

/// Adds the square as two triangles with the outward side in front.
fn add_square(
    grid: &Grid,
    voxel: [u32; 3],
    axis: usize,
    up: bool,
    raster: u64,
    geometry: &mut Geometry,
    fragments: &mut Fragments,
) {
    let corner = |du: u32, dv: u32| {
        let mut lattice = voxel;
        lattice[axis] += up as u32;
        lattice[(axis + 1) % 3] += du;
        lattice[(axis + 2) % 3] += dv;
        (grid.origin + grid.voxel_size * DVec3::from(lattice.map(f64::from))).as_vec3()
    };
    let base = geometry.positions.len() as u32;
    geometry.positions.extend([corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)]);
    let triangles = if up { [[0, 1, 2], [0, 2, 3]] } else { [[0, 2, 1], [0, 3, 2]] };
    for t in triangles {
        fragments.push(geometry.triangles.len() as u32, raster, [Vec2::ZERO, Vec2::X, Vec2::Y]);
        geometry.triangles.push(t.map(|v| base + v));
    }
}
