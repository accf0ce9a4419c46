//! `PatchSource::Faces`: the paper's method, to the letter.

mod common;

use common::{World, faces, options};
use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions, Scene,
    options::{FaceColour, Reconstruct},
    progress::Silent,
    scene::{Material, RawMaterial},
};

/// A room with a block, its floor red.
fn room() -> Scene {
    let mut world = World::new();
    let wall = world.grey(0.6, 0.0);
    world.room(DVec3::ZERO, DVec3::new(1.0, 1.1, 0.9), wall);
    world.block(DVec3::new(0.3, 0.3, 0.2), DVec3::new(0.6, 0.55, 0.6), wall);
    world.point_light(DVec3::new(0.8, 0.8, 0.7), 100.0);
    world.build().scene
}

fn bake(scene: &Scene, options: &BakeOptions) -> luxel::bake::Bake {
    luxel::bake(scene, options, &Silent).expect("a bake")
}

#[test]
fn patches_are_equal_squares_that_face_along_the_axes() {
    let bake = bake(&room(), &faces(options(10, 64)));
    let h = bake.simplified.grid.voxel_size as f32;
    assert!(bake.patches().len() > 300);
    for i in 0..bake.patches().len() {
        assert!((bake.patches().area[i] / (h * h) - 1.0).abs() < 1e-5);
        let n = bake.patches().normal[i].abs();
        assert!(n.max_element() > 0.99999 && n.dot(Vec3::ONE) < 1.00001);
        // Half a voxel off the centre of its voxel, outwards.
        let centre = bake.simplified.grid.centre(bake.simplified.grid.voxel_at(bake.patches().voxel[i]));
        let off = bake.patches().centroid[i] - centre.as_vec3();
        assert!(off.distance(0.5 * h * bake.patches().normal[i]) < 1e-5);
    }
}

#[test]
fn no_face_lies_between_two_occupied_voxels_or_inside_the_block() {
    let scene = room();
    let bake = bake(&scene, &faces(options(14, 64)));
    let grid = bake.simplified.grid;
    let occupied: std::collections::HashSet<u64> = luxel::simplify::clip(&scene, &grid).voxel.iter().copied().collect();
    for i in 0..bake.patches().len() {
        let step = (0.5 * grid.voxel_size) as f32 * bake.patches().normal[i];
        let beyond = (bake.patches().centroid[i] + step).as_dvec3();
        let cell = (beyond - grid.origin) / grid.voxel_size;
        if cell.min_element() >= 0.0 && cell.cmplt(DVec3::from(grid.dims.map(f64::from))).all() {
            assert!(!occupied.contains(&grid.raster(grid.voxel_of(beyond))), "patch {i}");
        }
        // All faces are in the air of the room: those in the block or behind walls are dropped.
        let at = scene.frame.to_world(bake.patches().centroid[i]);
        let in_room = at.min_element() > 0.0 && at.x < 1.0 && at.y < 1.1 && at.z < 0.9;
        let in_block = at.x > 0.3 && at.x < 0.6 && at.y > 0.3 && at.y < 0.55 && at.z > 0.2 && at.z < 0.6;
        assert!(in_room && !in_block, "patch {i} at {at}");
    }
}

#[test]
fn points_take_the_four_nearest_patches_by_inverse_distance() {
    let scene = room();
    let options = BakeOptions { reconstruct: Reconstruct::Nearest4, ..faces(options(10, 64)) };
    let bake = bake(&scene, &options);
    let cos = 60.0_f32.to_radians().cos();
    for (k, point) in bake.mesh.samples.iter().enumerate().step_by(7) {
        // The definition, by looking at every patch.
        let mut near: Vec<(f32, usize)> = (0..bake.patches().len())
            .filter(|&j| bake.light.known[j] && bake.patches().normal[j].dot(point.normal) >= cos)
            .map(|j| (bake.patches().centroid[j].distance(point.position), j))
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        // Equal distances leave the choice open.
        if near.len() > 4 && near[4].0 - near[3].0 < 1e-6 {
            continue;
        }
        let weights: f32 = near.iter().take(4).map(|n| 1.0 / n.0).sum();
        let expected: Vec3 = near.iter().take(4).map(|&(d, j)| bake.light.indirect[j] / d).sum::<Vec3>() / weights;
        let got = bake.vertices.indirect[k];
        assert!((got - expected).abs().max_element() <= 1e-4 * expected.max_element().max(1e-3), "{got} {expected}");
    }
}

#[test]
fn colours_of_a_voxel_mix_by_projected_area() {
    // Two strips, albedo 0.2 and 0.8, that share a row of voxels three to one.
    let mut world = World::new();
    let mut colour = |albedo: f32| {
        let surface = Material { albedo: Vec3::splat(albedo), ..Material::default() };
        world.builder.add_material(RawMaterial { surface, ..RawMaterial::default() })
    };
    let (dark, bright) = (colour(0.2), colour(0.8));
    world.quad("dark", DVec3::ZERO, DVec3::X * 0.5, DVec3::Y, dark);
    world.quad("bright", DVec3::X * 0.5, DVec3::X * 0.5, DVec3::Y, bright);
    world.point_light(DVec3::new(0.5, 0.5, 1.0), 10.0);
    let scene = world.build().scene;
    let base = faces(options(8, 64));
    let normalised = bake(&scene, &base);
    let literal = bake(&scene, &BakeOptions { face_colour: FaceColour::Literal, ..base });
    let grid = normalised.simplified.grid;
    let mut mixed = 0;
    for i in (0..normalised.patches().len()).filter(|&i| normalised.patches().normal[i].z > 0.5) {
        let low = grid.centre(grid.voxel_at(normalised.patches().voxel[i])) - 0.5 * grid.voxel_size;
        let h = grid.voxel_size;
        let overlap = |a0: f64, a1: f64, b0: f64| (a1.min(b0 + h) - a0.max(b0)).max(0.0);
        let y = overlap(-0.5, 0.5, low.y);
        let (d, b) = (overlap(-0.5, 0.0, low.x) * y, overlap(0.0, 0.5, low.x) * y);
        let mean = (0.2 * d + 0.8 * b) / (d + b);
        assert!((normalised.patches().albedo[i].x as f64 - mean).abs() < 1e-5);
        assert!((literal.patches().albedo[i].x as f64 - (0.2 * d + 0.8 * b) / (h * h)).abs() < 1e-5);
        mixed += (d > 0.0 && b > 0.0) as usize;
    }
    assert!(mixed >= 8, "{mixed}");
}
