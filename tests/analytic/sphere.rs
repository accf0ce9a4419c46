//! Inside a sphere the indirect irradiance is uniform, Phi rho / (A (1 - rho)), wherever the light stands.

use glam::DVec3;

use crate::common::{World, faces, options, patch_mean, vertex_mean};

const FLUX: f64 = 100.0;

fn lit(light: DVec3, albedo: f32, levels: u32) -> crate::common::Stage {
    let mut world = World::new();
    let material = world.grey(albedo, 0.0);
    world.sphere(DVec3::ZERO, 1.0, levels, material);
    world.point_light(light, FLUX);
    world.build()
}

#[test]
fn a_sphere_is_lit_evenly_by_a_lamp_anywhere() {
    const LEVELS: u32 = 4;
    for light in [DVec3::ZERO, DVec3::new(0.3, -0.2, 0.1), DVec3::new(-0.4, 0.5, 0.3)] {
        let albedo = 0.7_f32;
        let stage = lit(light, albedo, LEVELS);
        let options = options(16, 1024);
        let bake = stage.bake(&options);
        let rho = albedo as f64;
        let expected = FLUX * rho / (stage.area() * (1.0 - rho));
        let mean = patch_mean(&bake, &bake.light.indirect) / expected - 1.0;

        // Every row is an estimate by `rays` of the mean radiosity; independent rays would err by its deviation.
        let b = &bake.light.radiosity;
        let m = patch_mean(&bake, b);
        let variance = patch_mean(&bake, &b.iter().map(|b| (*b - m as f32) * (*b - m as f32)).collect::<Vec<_>>());
        let noise = (variance / options.rays as f64).sqrt() / expected;
        // Facets stand off the sphere's normals by up to half an edge over the radius: edges are 1.1 / 2^levels.
        let facets = (0.5 * 1.1 / 2.0_f64.powi(LEVELS as i32)).powi(2);
        let errors = bake.light.indirect.iter().map(|e| (e.x as f64 / expected - 1.0).abs());
        let worst = errors.fold(0.0, f64::max);
        println!(
            "sphere, lamp at {light}: mean {:+.4} %, largest error {:.3} % (one ray set: {:.3} %, facets {:.3} %)",
            100.0 * mean,
            100.0 * worst,
            100.0 * noise,
            100.0 * facets
        );
        // The largest of some 1000 normal deviates stays below 4.5 sigma.
        assert!(worst < 4.5 * noise + 2.0 * facets, "{worst}");
        // Direct light is sampled at 32 points a patch; rows err independently.
        assert!(mean.abs() < 4.0 * noise / (b.len() as f64).sqrt() + facets, "{mean}");
    }
}

/// The voxel trap: a sphere's staircase has 1.5 times its area, so the paper's patches spread the light too thin.
#[test]
fn voxel_faces_of_a_sphere_hold_the_wrong_energy_and_surfels_the_right_one() {
    let stage = lit(DVec3::ZERO, 0.5, 4);
    let expected = FLUX * 0.5 / (stage.area() * 0.5);
    let surfels = stage.bake(&options(16, 256));
    let staircase = stage.bake(&faces(options(16, 256)));
    let error = |bake: &luxel::bake::Bake| vertex_mean(bake, &bake.vertices.indirect) / expected - 1.0;
    let area: f64 = staircase.patches().area.iter().map(|&a| a as f64).sum::<f64>() * stage.scene.frame.scale.powi(2);
    println!(
        "voxel trap, sphere: surfels {:+.2} %, faces {:+.2} %; staircase area {:.3} of the sphere's",
        100.0 * error(&surfels),
        100.0 * error(&staircase),
        area / stage.area()
    );
    assert!(error(&surfels).abs() < 0.005);
    assert!(error(&staircase).abs() > 0.1);
    // Faces shrunk inwards by about half a voxel of 1/8: (1 - 1/16)^2 * 1.5 = 1.32, a wide margin around it.
    assert!((1.2..1.5).contains(&(area / stage.area())), "{area}");
}
