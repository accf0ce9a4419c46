//! The same input, seed and build give the same bytes.

mod common;

use common::{World, faces, options};
use glam::DVec3;
use luxel::{
    BakeOptions,
    bake::Bake,
    options::{Backend, PatchSource, Primary, Reconstruct},
};

fn bake(options: &BakeOptions) -> Bake {
    let mut world = World::new();
    let (wall, lamp) = (world.grey(0.7, 0.0), world.grey(0.2, 5.0));
    world.room(DVec3::ZERO, DVec3::new(1.3, 1.0, 0.8), wall);
    world.block(DVec3::new(0.31, 0.2, 0.0), DVec3::new(0.6, 0.53, 0.35), wall);
    world.quad("lamp", DVec3::new(0.4, 0.4, 0.75), DVec3::Y * 0.3, DVec3::X * 0.3, lamp);
    world.point_light(DVec3::new(1.1, 0.8, 0.3), 3.0);
    world.build().bake(options)
}

/// Every result, as bytes.
fn bytes(bake: &Bake) -> Vec<u8> {
    let vectors = [
        &bake.mesh.positions,
        &bake.mesh.normals,
        &bake.mesh.albedo,
        &bake.vertices.direct,
        &bake.vertices.indirect,
        &bake.light.direct,
        &bake.light.indirect,
        &bake.light.radiosity,
        &bake.patches().centroid,
        &bake.patches().normal,
        &bake.patches().albedo,
    ];
    let mut all: Vec<u8> =
        vectors.into_iter().flatten().flat_map(|v| v.to_array()).flat_map(f32::to_le_bytes).collect();
    all.extend(bake.mesh.triangles.iter().flatten().flat_map(|v| v.to_le_bytes()));
    for i in 0..bake.patches().len() {
        for (j, f) in bake.form_factors.row(i) {
            all.extend((j as u64).to_le_bytes());
            all.extend(f.to_le_bytes());
        }
    }
    all
}

fn with_threads(threads: usize, options: &BakeOptions) -> Vec<u8> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
    pool.install(|| bytes(&bake(options)))
}

#[test]
fn one_two_and_five_threads_give_the_same_bytes_on_every_backend() {
    for backend in [Backend::Auto, Backend::Bvh, Backend::Brute] {
        let options = BakeOptions { backend, ..options(10, 64) };
        let one = with_threads(1, &options);
        assert!(one.len() > 100_000);
        for threads in [2, 5] {
            assert!(one == with_threads(threads, &options), "{backend:?}, {threads} threads");
        }
    }
}

#[test]
fn every_mode_gives_the_same_bytes_with_any_number_of_threads() {
    let modes = [
        faces(options(10, 64)),
        BakeOptions { primary: Primary::Radiosity, ..options(10, 64) },
        BakeOptions { reconstruct: Reconstruct::Nearest4, ..faces(options(10, 64)) },
        BakeOptions { skip_unreached: false, ..options(10, 64) },
        BakeOptions { reconstruct: Reconstruct::Gather, gather_rays: 64, ..options(10, 64) },
        BakeOptions { reconstruct: Reconstruct::Adaptive, patches: PatchSource::Decimated, ..options(10, 64) },
        BakeOptions { patches: PatchSource::Clustered, ..options(10, 64) },
    ];
    for options in modes {
        let one = with_threads(1, &options);
        assert!(one == with_threads(5, &options), "{options:?}");
    }
}

#[test]
fn a_seed_gives_the_same_bytes_twice_and_another_seed_others() {
    let base = options(10, 64);
    let first = bytes(&bake(&base));
    assert!(first == bytes(&bake(&base)));
    let other = bake(&BakeOptions { seed: 1, ..base });
    assert!(first != bytes(&other));
}
