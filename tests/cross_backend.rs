//! Form factors and whole bakes agree between brute force, obvhs and Embree.

mod common;

use common::{Stage, World, faces, options};
use glam::{DVec3, Vec3};
use luxel::{BakeOptions, bake::Bake, options::Backend, sampling, scene::WorldLight};

fn backends() -> Vec<Backend> {
    let embree = cfg!(feature = "embree").then_some(Backend::Embree);
    [Some(Backend::Bvh), embree].into_iter().flatten().collect()
}

fn furnished() -> Stage {
    let mut world = World::new();
    let (wall, lamp) = (world.grey(0.7, 0.0), world.grey(0.2, 5.0));
    world.room(DVec3::ZERO, DVec3::new(1.3, 1.0, 0.8), wall);
    world.block(DVec3::new(0.31, 0.2, 0.0), DVec3::new(0.6, 0.53, 0.35), wall);
    world.quad("lamp", DVec3::new(0.4, 0.4, 0.75), DVec3::Y * 0.3, DVec3::X * 0.3, lamp);
    world.build()
}

/// Triangles that pass through each other, under a sky.
fn soup() -> Stage {
    let mut world = World::new();
    let grey = world.grey(0.6, 0.0);
    let number = |k: u64| sampling::hash(&[7, k]) as f64 / u64::MAX as f64 - 0.5;
    for t in 0..40 {
        let corner = |c: u64| DVec3::new(number(9 * t + 3 * c), number(9 * t + 3 * c + 1), number(9 * t + 3 * c + 2));
        world.mesh("soup", vec![corner(0), corner(1), corner(2)], vec![[0, 1, 2]], grey);
    }
    world.builder.add_light(WorldLight::Sky { radiance: Vec3::ONE });
    world.build()
}

fn one_triangle() -> Stage {
    let mut world = World::new();
    let grey = world.grey(0.6, 0.0);
    world.mesh("one", vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]], grey);
    world.builder.add_light(WorldLight::Sky { radiance: Vec3::ONE });
    world.build()
}

const RAYS: u32 = 64;

/// The rays are the same on every backend. An answer differs only where a ray passes an edge, or two surfaces cross,
/// within rounding (1e-6 of the scene, against triangles and voxels of 1e-2 and more): one ray in ten thousand.
const DIFFERENT: f64 = 1e-4;

fn compare(stage: &Stage, options: &BakeOptions) {
    let on = |backend| stage.bake(&BakeOptions { backend, ..options.clone() });
    let oracle = on(Backend::Brute);
    for backend in backends() {
        let bake = on(backend);
        let patches = oracle.patches().len();
        assert_eq!(bake.patches().len(), patches, "{backend:?}");
        let moved: f64 = (0..patches).map(|i| moved(&oracle, &bake, i)).sum::<f64>() / patches as f64;
        assert!(moved <= DIFFERENT, "{backend:?}: {moved} of the form factors are different");
        // A ray that differs changes the irradiance of its patch by 1 / RAYS of what is seen.
        let difference = relative_rms(&oracle.light.indirect, &bake.light.indirect);
        let expected = (DIFFERENT / RAYS as f64).sqrt();
        assert!(difference <= 4.0 * expected, "{backend:?}: {difference}, expected up to {expected}");
        let difference = relative_rms(&oracle.vertices.indirect, &bake.vertices.indirect);
        assert!(difference <= 4.0 * expected, "{backend:?}, vertices: {difference}");
    }
}

/// Share of row `i` that goes to other patches.
fn moved(a: &Bake, b: &Bake, i: usize) -> f64 {
    let mut row = vec![0.0; a.patches().len()];
    a.form_factors.row(i).for_each(|(j, f)| row[j] += f);
    b.form_factors.row(i).for_each(|(j, f)| row[j] -= f);
    0.5 * row.iter().map(|d: &f64| d.abs()).sum::<f64>()
}

fn relative_rms(a: &[Vec3], b: &[Vec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    let mean = a.iter().map(|v| v.x as f64).sum::<f64>() / a.len() as f64;
    let square = a.iter().zip(b).map(|(a, b)| (a.x as f64 - b.x as f64).powi(2)).sum::<f64>() / a.len() as f64;
    if mean > 0.0 { square.sqrt() / mean } else { square.sqrt() }
}

#[test]
fn a_furnished_room_bakes_alike() {
    compare(&furnished(), &options(12, RAYS));
}

#[test]
fn a_furnished_room_of_voxel_faces_bakes_alike() {
    compare(&furnished(), &faces(options(10, RAYS)));
}

#[test]
fn a_soup_bakes_alike() {
    compare(&soup(), &options(8, RAYS));
}

#[test]
fn a_single_triangle_bakes_alike() {
    compare(&one_triangle(), &options(8, RAYS));
}
