//! White furnaces: in a closed scene of uniform emitted exitance M and albedo rho, B = M / (1 - rho) everywhere.

use std::f64::consts::PI;

use glam::DVec3;
use luxel::{
    BakeOptions,
    options::{PatchSource, Primary, Reconstruct},
};

use crate::common::{Stage, World, faces, options, rotation};

const ALBEDOS: [f32; 5] = [0.5, 0.9, 0.99, 0.999, 0.9999];

fn cube(albedo: f32) -> World {
    let mut world = World::new();
    let material = world.grey(albedo, 1.0);
    world.room(DVec3::ZERO, DVec3::new(1.0, 1.0, 1.0), material);
    world
}

fn turned_cube(albedo: f32) -> World {
    let mut world = cube(albedo);
    world.transform(rotation());
    world
}

fn ball(albedo: f32) -> World {
    let mut world = World::new();
    let material = world.grey(albedo, 1.0);
    world.sphere(DVec3::ZERO, 1.0, 3, material);
    world
}

/// Bakes at all albedos; the rows of a closed scene sum to 1 exactly, so only solver and rounding err.
fn check(what: &str, build: impl Fn(f32) -> World, options: BakeOptions) {
    for albedo in ALBEDOS {
        let stage: Stage = build(albedo).build();
        let bake = stage.bake(&BakeOptions { primary: Primary::Radiosity, ..options.clone() });
        assert!(bake.form_factors.is_closed(), "{what}: {:?}", bake.report.row_sums);
        let rho = albedo as f64;
        let expected = PI / (1.0 - rho);
        let mut error = 0.0_f64;
        for i in (0..bake.patches().len()).filter(|&i| bake.form_factors.has_row(i)) {
            let b = bake.patches().emitted[i].x as f64 + bake.light.radiosity[i].x as f64;
            error = error.max((b / expected - 1.0).abs());
        }
        println!(
            "furnace, {what}, albedo {albedo}: largest error {error:.2e}, {} steps",
            bake.report.solver.iterations
        );
        // |error| <= |residual| / (1 - rho) for rows that sum to 1, and the residual is relative to the source rho M;
        // an albedo rounded by an ulp changes B by that over 1 - rho; light is f32.
        let ulp = f32::EPSILON as f64;
        let limit = options.tolerance * rho + ulp * rho / (1.0 - rho) + 8.0 * ulp;
        assert!(error <= limit, "{what}, albedo {albedo}: {error:e} > {limit:e}");
        assert!(bake.report.solver.residual <= options.tolerance);
    }
}

#[test]
fn a_white_furnace_glows_evenly() {
    check("cube", cube, options(8, 256));
    check("cube turned", turned_cube, options(8, 256));
    check("sphere", ball, options(8, 256));
}

#[test]
fn a_white_furnace_of_voxel_faces_glows_evenly() {
    check("cube of faces", cube, faces(options(8, 256)));
    check("cube turned, of faces", turned_cube, faces(options(8, 256)));
    check("sphere of faces", ball, faces(options(8, 256)));
}

/// Edge collapse keeps closed meshes closed. Clusters fold where walls meet, if not along the axes: turned cubes leak.
#[test]
fn a_white_furnace_of_simplified_meshes_glows_evenly() {
    let decimated = BakeOptions { patches: PatchSource::Decimated, ..options(8, 256) };
    check("cube turned, decimated", turned_cube, decimated.clone());
    check("sphere, decimated", ball, decimated);
    check("cube, clustered", cube, BakeOptions { patches: PatchSource::Clustered, ..options(8, 256) });
}

/// The whole way to the vertices: irradiance M / (1 - rho) there too, the constant being in the span of every fit.
#[test]
fn a_white_furnace_lights_every_vertex_evenly() {
    let by = |reconstruct, options| BakeOptions { reconstruct, gather_rays: 64, ..options };
    for (what, options) in [
        ("surfels", options(8, 256)),
        ("faces", faces(options(8, 256))),
        ("surfels, gather", by(Reconstruct::Gather, options(8, 256))),
        ("surfels, adaptive", by(Reconstruct::Adaptive, options(8, 256))),
        ("faces, gather", by(Reconstruct::Gather, faces(options(8, 256)))),
        ("decimated", BakeOptions { patches: PatchSource::Decimated, ..options(8, 256) }),
    ] {
        let bake = turned_cube(0.9).build().bake(&BakeOptions { primary: Primary::Radiosity, ..options });
        let expected = PI / (1.0 - 0.9_f32 as f64);
        let all = bake.vertices.direct.iter().zip(&bake.vertices.indirect).map(|(d, i)| (d.x + i.x) as f64);
        let error = all.map(|e| (e / expected - 1.0).abs()).fold(0.0, f64::max);
        println!("furnace, vertices, {what}: largest error {error:.2e}");
        assert!(error < 1e-5, "{what}: {error}");
    }
}
