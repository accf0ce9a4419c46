//! Bakes a mesh built in memory, stage by stage: `cargo run --example in_memory`.
//!
//! A closed room of 2 x 2 x 2 m with a lamp below its ceiling. What [`luxel::bake`] does in one call is done here with
//! the calls that it makes, in the order of the README's pipeline.

use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions, Result, Scene,
    light::{self, LightSet},
    progress::Silent,
    reconstruct::{self, Field, Level, PatchIndex},
    scene::SurfacePoint,
    scene::{Builder, Material, RawMaterial, RawMesh, SidesRule},
    simplify::{self, Grid},
    solve, trace,
    transfer::{self, patch_points},
};

fn main() -> Result<()> {
    let options = BakeOptions::default();
    let scene = room()?;
    let floor = floor(&scene);
    println!("scene        {} triangles", scene.triangles.len());

    let staged = indirect_by_stages(&scene, &options, floor)?;
    println!("by stages    indirect irradiance of the floor {staged:.4} W/m2");

    let bake = luxel::bake(&scene, &options, &Silent)?;
    let light = bake.irradiance(&[floor], &Silent);
    println!("in one call  direct {:.4}, indirect {:.4} W/m2", light.direct[0], light.indirect[0]);
    let energy = &bake.report.energy;
    println!("energy       {:.4} W received directly, {:.4} W absorbed", energy.direct[0], energy.absorbed[0]);
    Ok(())
}

/// A room with a red wall and a lamp of 0.5 x 0.5 m that faces down, radiance 10.
pub fn room() -> Result<Scene> {
    let mut builder = Builder::new("room");
    let mut material = |name: &str, albedo: Vec3, emission: f32| {
        let surface = Material { name: name.into(), albedo, emission: Vec3::splat(emission), ..Material::default() };
        builder.add_material(RawMaterial { surface, ..RawMaterial::default() })
    };
    let white = material("white", Vec3::splat(0.7), 0.0);
    let red = material("red", Vec3::new(0.6, 0.05, 0.05), 0.0);
    let lamp = material("lamp", Vec3::ZERO, 10.0);

    // Counter-clockwise seen from inside, so that the normals point into the room.
    let (o, x, y, z) = (DVec3::ZERO, 2.0 * DVec3::X, 2.0 * DVec3::Y, 2.0 * DVec3::Z);
    let mut rectangle = |name: &str, corner: DVec3, u: DVec3, v: DVec3, material: u32| {
        builder.add_mesh(RawMesh {
            name: name.into(),
            positions: vec![corner, corner + u, corner + u + v, corner + v],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material,
            ..RawMesh::default()
        });
    };
    rectangle("floor", o, z, x, white);
    rectangle("ceiling", o + y, x, z, white);
    rectangle("left", o, y, z, red);
    rectangle("right", o + x, z, y, white);
    rectangle("back", o, x, y, white);
    rectangle("front", o + z, y, x, white);
    rectangle("lamp", DVec3::new(0.75, 1.9, 0.75), 0.5 * DVec3::X, 0.5 * DVec3::Z, lamp);
    builder.build(SidesRule::Auto)
}

/// The middle of the floor, in the local frame.
pub fn floor(scene: &Scene) -> SurfacePoint {
    SurfacePoint { position: scene.frame.to_local(DVec3::new(1.0, 0.0, 1.0)), normal: Vec3::Y }
}

/// Indirect irradiance at one point, W/m2.
pub fn indirect_by_stages(scene: &Scene, options: &BakeOptions, at: SurfacePoint) -> Result<Vec3> {
    let tracer = trace::build(options.backend, &scene.geometry())?;
    println!("tracer       {}", tracer.name());

    // Steps 1-4 of the paper: from triangles to patches.
    let grid = Grid::new(scene, options.resolution)?;
    let simplified = simplify::surfels(scene, grid, &*tracer);
    let patches = &simplified.patches;
    println!("simplify     {} fragments, {} patches", simplified.fragments.len(), patches.len());

    // Direct light, the source of the radiosity.
    let all: Vec<u32> = (0..patches.len() as u32).collect();
    let (samples, seed) = (options.patch_samples, options.seed);
    let points = patch_points(&simplified, &all, samples, seed);
    let lights = LightSet::new(scene);
    let direct = light::irradiance(&lights, &*tracer, &points, samples as usize, samples, seed);
    println!("direct       {} shadow rays", direct.rays);

    // Step 6: form factors of the patches that light can reach.
    let lit: Vec<bool> = direct.irradiance.iter().map(|&e| e != Vec3::ZERO).collect();
    let estimate = transfer::estimate(&simplified, &*tracer, &lit, false, options.rays, seed, &Silent)?;
    let f = &estimate.form_factors;
    println!("transfer     {} rays, {} form factors in {} bytes", estimate.rays, f.nonzeros(), f.size_in_bytes());

    // B = M + rho F B, where M is the direct light that the patches reflect. What a patch hides was counted as dark.
    let albedo: Vec<[f64; 3]> = patches.albedo.iter().map(|a| a.to_array().map(f64::from)).collect();
    let source: Vec<[f64; 3]> = (0..patches.len())
        .map(|i| {
            let shown = (1.0 - f.hidden(i) as f32).max(0.05);
            std::array::from_fn(|c| (direct.irradiance[i][c] / shown) as f64 * albedo[i][c])
        })
        .collect();
    let solution = solve::solve(f, &albedo, &source, options.tolerance, false);
    println!("solve        {} iterations, residual {:.1e}", solution.iterations, solution.residual);

    // Step 5: back to the surfaces.
    let values: Vec<Vec3> = solution.irradiance.iter().map(|e| Vec3::from_array(e.map(|x| x as f32))).collect();
    let normals: Vec<Vec3> = (0..scene.triangles.len()).map(|t| scene.normal(t)).collect();
    let two_sided: Vec<bool> = scene.triangles.iter().map(|t| t.two_sided).collect();
    let field = Field {
        simplified: &simplified,
        index: &PatchIndex::new(patches, grid),
        values: &values,
        known: &estimate.visible,
        tracer: &*tracer,
        normals: &normals,
        two_sided: &two_sided,
        cos_threshold: options.normal_threshold.to_radians().cos(),
        senders: None,
        level: &Level::default(),
        stencils: None,
    };
    Ok(reconstruct::interpolate(&field, options.reconstruct, &[at])[0])
}
