//! The same input, seed and build give the same bytes.

mod common;

use common::{Stage, World, faces, options};
use glam::DVec3;
use luxel::{
    BakeOptions,
    bake::{Bake, Kept, Run, bake_with, prepare},
    options::{Backend, PatchSource, Primary, Reconstruct},
    progress::Silent,
    transfer::{Block, RowKeeper, Rows},
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
    let vectors: [&[_]; 11] = [
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
    all.extend(bake.error.iter().flat_map(|e| &e.total).flat_map(|e| e.to_le_bytes()));
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
        BakeOptions { skip: false, ..options(10, 64) },
        BakeOptions { estimate: true, ..options(10, 64) },
        BakeOptions { estimate: true, primary: Primary::Radiosity, ..faces(options(10, 64)) },
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

/// Two rooms that a gap joins, a closet without a door, and a light in one of the three; or none.
fn rooms(light: Option<DVec3>, albedo: f32) -> Stage {
    let mut world = World::new();
    let (wall, lamp) = (world.grey(albedo, 0.0), world.grey(0.2, if light.is_some() { 5.0 } else { 0.0 }));
    world.room(DVec3::ZERO, DVec3::new(2.0, 1.0, 1.0), wall);
    world.block(DVec3::new(0.95, -0.1, -0.1), DVec3::new(1.02, 1.1, 0.97), wall);
    world.named_room("closet", DVec3::new(2.5, 0.0, 0.0), DVec3::new(3.0, 0.6, 1.0), wall);
    world.block(DVec3::new(0.3, 0.3, 0.0), DVec3::new(0.5, 0.5, 0.4), wall);
    world.quad("lamp", DVec3::new(0.4, 0.4, 0.93), DVec3::Y * 0.1, DVec3::X * 0.1, lamp);
    world.quad("tile", DVec3::new(2.6, 0.1, 0.2), DVec3::X * 0.2, DVec3::Y * 0.2, wall);
    if let Some(place) = light {
        world.point_light(place, 3.0);
    }
    world.build()
}

fn run<'a>(keeper: &'a mut dyn RowKeeper) -> Run<'a> {
    Run { progress: &Silent, keeper, deadline: None }
}

#[test]
fn what_was_prepared_without_light_gives_the_same_bytes_under_any_light() {
    let base = BakeOptions { estimate: true, ..options(16, 64) };
    let modes = [
        base.clone(),
        BakeOptions { rays: 256, ..base.clone() },
        BakeOptions { skip: false, ..base.clone() },
        BakeOptions { only: vec!["closet".into()], rays: 256, ..base.clone() },
        BakeOptions { primary: Primary::Radiosity, ..base.clone() },
        BakeOptions { reconstruct: Reconstruct::Adaptive, gather_rays: 64, ..base.clone() },
        BakeOptions { patches: PatchSource::Decimated, ..base.clone() },
        faces(base),
    ];
    for options in modes {
        let mut kept = Kept::default();
        let cast =
            prepare(&rooms(None, 0.5).scene, &options, &mut kept, &mut run(&mut ())).expect("no light is needed");
        assert!(cast > 0);
        for (place, albedo) in [([0.7, 0.6, 0.5], 0.7), ([2.8, 0.3, 0.7], 0.3)] {
            let stage = rooms(Some(place.into()), albedo);
            let baked = bake_with(&stage.scene, &options, &mut kept, &mut run(&mut ())).expect("a bake");
            assert_eq!(baked.report.rays.form_factors, 0, "{options:?}");
            assert!(bytes(&baked) == bytes(&stage.bake(&options)), "{place:?}, {options:?}");
        }
    }
}

#[test]
fn rows_of_any_part_of_the_patches_give_the_same_bytes() {
    /// Remembers all blocks.
    #[derive(Default)]
    struct Memory(Vec<Block>);
    impl RowKeeper for Memory {
        fn keep(&mut self, block: Block) -> luxel::Result<Block> {
            self.0.push(block.clone());
            Ok(block)
        }
    }
    let stage = rooms(Some(DVec3::new(0.7, 0.6, 0.5)), 0.7);
    let options = options(16, 256);
    let mut keeper = Memory::default();
    let whole = bake_with(&stage.scene, &options, &mut Kept::default(), &mut run(&mut keeper)).expect("a bake");
    assert!(bytes(&whole) == bytes(&stage.bake(&options)));
    let mut kept = Kept { rows: Rows::new(whole.patches().len()), ..Kept::default() };
    keeper.0.into_iter().rev().step_by(3).for_each(|block| kept.rows.add(block));
    let resumed = bake_with(&stage.scene, &options, &mut kept, &mut run(&mut ())).expect("a bake");
    assert!(bytes(&resumed) == bytes(&whole));
    let (some, all) = (resumed.report.rays.form_factors, whole.report.rays.form_factors);
    assert!(0 < some && some < all, "{some} of {all}");
}
