//! Furnaces, spheres and the voxel trap.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::{
    Row, World,
    closed_forms::{closed_mean, furnace},
    options, rows,
    world::rotation,
};
use crate::{
    BakeOptions, Result, Scene,
    options::{Backend, PatchSource, Primary},
    progress::Silent,
};

/// Albedos of the furnaces, three in a bake.
pub const FURNACES: [[f32; 3]; 2] = [[0.5, 0.9, 0.99], [0.99, 0.999, 0.9999]];

/// A cube of side 1 that emits pi W/m2 everywhere.
pub fn furnace_cube(albedo: Vec3) -> World {
    let mut world = World::new();
    let material = world.coloured(albedo, 1.0);
    world.room(DVec3::ZERO, DVec3::ONE, material);
    world
}

/// The same, turned.
pub fn furnace_turned(albedo: Vec3) -> World {
    let mut world = furnace_cube(albedo);
    world.transform(rotation());
    world
}

/// A sphere of radius 1 that emits pi W/m2 everywhere.
pub fn furnace_sphere(albedo: Vec3) -> World {
    let mut world = World::new();
    let material = world.coloured(albedo, 1.0);
    world.sphere(DVec3::ZERO, 1.0, 3, material);
    world
}

/// White furnaces: one row an albedo, the worst patch of three shapes.
pub(super) fn furnaces(backend: Backend) -> Result<Vec<Row>> {
    let mut table: Vec<Row> = Vec::new();
    for build in [furnace_cube, furnace_turned, furnace_sphere] {
        let mut at = 0;
        for (set, albedos) in FURNACES.into_iter().enumerate() {
            let options = BakeOptions { primary: Primary::Radiosity, ..options(8, 256, backend) };
            let bake = crate::bake(&build(Vec3::from_array(albedos)).build()?.0, &options, &Silent)?;
            // The one albedo that both sets hold is told once.
            for (c, albedo) in albedos.into_iter().enumerate().skip(set) {
                let rho = albedo as f64;
                let rows: Vec<usize> = (0..bake.patches().len()).filter(|&i| bake.form_factors.has_row(i)).collect();
                let total = |&i: &usize| (bake.patches().emitted[i][c] + bake.light.radiosity[i][c]) as f64;
                let got: Vec<f64> = rows.iter().map(total).collect();
                // |error| <= |residual| / (1 - rho) for rows that sum to 1, and the residual is relative to the largest
                // source; an albedo rounded by an ulp changes B by that over 1 - rho; light is f32.
                let ulp = f32::EPSILON as f64;
                let bound = options.tolerance + ulp * rho / (1.0 - rho) + 8.0 * ulp;
                let expected = vec![furnace(PI, rho); got.len()];
                let row = Row::worst(format!("white furnaces, albedo {albedo}"), &got, &expected, bound);
                match table.get_mut(at) {
                    Some(before) => *before = before.clone().or_worse(row),
                    None => table.push(row),
                }
                at += 1;
            }
        }
    }
    Ok(table)
}

/// Power of the lamps in the spheres, W.
pub const SPHERE_FLUX: f64 = 100.0;

/// A sphere of radius 1 around a point light.
pub fn lit_sphere(light: DVec3, albedo: f32, levels: u32) -> World {
    let mut world = World::new();
    let material = world.grey(albedo, 0.0);
    world.sphere(DVec3::ZERO, 1.0, levels, material);
    world.point_light(light, SPHERE_FLUX);
    world
}

/// Area of the surfaces of a scene, world units.
pub fn area(scene: &Scene) -> f64 {
    (0..scene.triangles.len()).map(|t| scene.area(t)).sum::<f64>() * scene.frame.scale.powi(2)
}

/// Squared angle by which the facets of a sphere that is split `levels` times stand off its normals: edges are 1.1 / 2^levels,
/// half of one over the radius is the angle. Light and form factors between facets are off by that.
pub fn facets(levels: u32) -> f64 {
    (0.5 * 1.1 / 2.0_f64.powi(levels as i32)).powi(2)
}

/// Standard error of the mean of one independent set of rays a patch, relative to `expected`: every row estimates the mean
/// radiosity, whose deviation over the patches is what it errs by.
pub fn row_noise(bake: &crate::bake::Bake, rays: u32, expected: f64) -> f64 {
    let b = &bake.light.radiosity;
    let mean = rows::patch_mean(bake, b).as_vec3();
    let squares: Vec<Vec3> = b.iter().map(|b| (*b - mean) * (*b - mean)).collect();
    (rows::patch_mean(bake, &squares).x / rays as f64).sqrt() / expected
}

/// How often the self-test's spheres are split, and where their lamps stand.
const LEVELS: u32 = 3;
const ASIDE: DVec3 = DVec3::new(-0.4, 0.5, 0.3);

/// Inside of a sphere the indirect light of any lamp is the same everywhere, and form factors are shares of the area.
pub(super) fn spheres(backend: Backend) -> Result<Vec<Row>> {
    const ALBEDO: f32 = 0.7;
    let scene = lit_sphere(ASIDE, ALBEDO, LEVELS).build()?.0;
    let options = options(12, 1024, backend);
    let bake = crate::bake(&scene, &options, &Silent)?;
    let expected = closed_mean(SPHERE_FLUX, area(&scene), ALBEDO as f64);
    let noise = row_noise(&bake, options.rays, expected);
    let mean = rows::patch_mean(&bake, &bake.light.indirect).x;
    let indirect: Vec<f64> = bake.light.indirect.iter().map(|e| e.x as f64).collect();
    let n = indirect.len();
    let mut table = vec![
        // Exact of any closed enclosure; rows err independently.
        Row::sigmas("sphere, lamp aside, mean", mean, expected, noise * expected / (n as f64).sqrt()),
        // The largest of some thousand normal deviates stays below 4.5 sigma.
        Row::worst(
            "sphere, lamp aside, every patch",
            &indirect,
            &vec![expected; n],
            4.5 * noise + 2.0 * facets(LEVELS),
        ),
    ];

    // Octants: F_ij = A_j / A.
    let octant = |i: usize| {
        let c = bake.patches().centroid[i];
        (c.x > 0.0) as usize + 2 * (c.y > 0.0) as usize + 4 * (c.z > 0.0) as usize
    };
    let octants: Vec<usize> = (0..n).map(octant).collect();
    let total: f64 = bake.patches().area.iter().map(|&a| a as f64).sum();
    let pairs = (0..8).flat_map(|from| (0..8).map(move |to| (from, to)));
    let exchanged = pairs.map(|(from, to)| {
        let share: f64 =
            (0..n).filter(|&j| octants[j] == to).map(|j| bake.patches().area[j] as f64).sum::<f64>() / total;
        let (f, sigma) =
            rows::between(bake.patches(), &bake.form_factors, &options, |i| octants[i] == from, |j| octants[j] == to);
        Row::sigmas("sphere, form factors between octants", f, share, sigma + share * facets(LEVELS))
    });
    table.extend(exchanged.reduce(Row::or_worse));
    Ok(table)
}

/// The voxel trap: the faces of the voxels of a surface have more area than it, pieces of the surface have not.
pub(super) fn voxel_trap(backend: Backend) -> Result<Vec<Row>> {
    let mut table = Vec::new();
    for (what, world) in
        [("sphere", lit_sphere(ASIDE, 0.5, LEVELS)), ("turned cube", super::cie::cube(Vec3::splat(0.5), true))]
    {
        let scene = world.build()?.0;
        let (flux, surface) = (if what == "sphere" { SPHERE_FLUX } else { super::cie::FLUX }, area(&scene));
        let expected = closed_mean(flux, surface, 0.5);
        for patches in [PatchSource::Surfels, PatchSource::Faces] {
            let options = BakeOptions { patches, ..options(16, 256, backend) };
            let bake = crate::bake(&scene, &options, &Silent)?;
            let area: f64 = bake.patches().area.iter().map(|&a| a as f64).sum::<f64>() * scene.frame.scale.powi(2);
            let mean = rows::patch_mean(&bake, &bake.light.indirect).x;
            table.extend(match patches {
                PatchSource::Surfels => [
                    // Areas are f32.
                    Row::error(format!("voxel trap, {what}: area of surfels"), area, surface, 1e-5),
                    Row::sigmas(
                        format!("voxel trap, {what}: light of surfels"),
                        mean,
                        expected,
                        row_noise(&bake, options.rays, expected) * expected / (bake.patches().len() as f64).sqrt(),
                    ),
                ],
                _ => [
                    Row::info(format!("voxel trap, {what}: area of faces"), area, surface),
                    Row::info(format!("voxel trap, {what}: light of faces"), mean, expected),
                ],
            });
        }
    }
    Ok(table)
}
