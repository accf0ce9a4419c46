//! Inside a sphere the indirect irradiance is uniform, Phi rho / (A (1 - rho)), wherever the light stands.

use glam::DVec3;
use luxel::selftest::{
    closed_forms::closed_mean,
    enclosures::{self, SPHERE_FLUX as FLUX},
};

use crate::{
    common::{Stage, World, faces, options, patch_mean, vertex_mean},
    passes,
};

fn lit(light: DVec3, albedo: f32, levels: u32) -> Stage {
    World::from(enclosures::lit_sphere(light, albedo, levels)).build()
}

#[test]
fn a_sphere_s_form_factors_are_shares_of_its_area() {
    passes("spheres");
}

#[test]
fn a_sphere_is_lit_evenly_by_a_lamp_anywhere() {
    const LEVELS: u32 = 4;
    for light in [DVec3::ZERO, DVec3::new(0.3, -0.2, 0.1), DVec3::new(-0.4, 0.5, 0.3)] {
        let albedo = 0.7_f32;
        let stage = lit(light, albedo, LEVELS);
        let options = options(16, 1024);
        let bake = stage.bake(&options);
        let expected = closed_mean(FLUX, stage.area(), albedo as f64);
        let mean = patch_mean(&bake, &bake.light.indirect) / expected - 1.0;

        let noise = enclosures::row_noise(&bake, options.rays, expected);
        let facets = enclosures::facets(LEVELS);
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
        assert!(mean.abs() < 4.0 * noise / (bake.patches().len() as f64).sqrt() + facets, "{mean}");
    }
}

#[test]
fn voxel_faces_have_more_area_than_the_surface_and_surfels_have_not() {
    passes("voxel trap");
}

/// The voxel trap: a sphere's staircase has 1.5 times its area, so the paper's patches spread the light too thin.
#[test]
fn voxel_faces_of_a_sphere_hold_the_wrong_energy_and_surfels_the_right_one() {
    let stage = lit(DVec3::ZERO, 0.5, 4);
    let expected = closed_mean(FLUX, stage.area(), 0.5);
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
