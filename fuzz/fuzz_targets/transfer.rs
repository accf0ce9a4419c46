//! Transfer files with payloads that are wrong and checksums that fit: what is read is lit, and nothing may panic.
//!
//! Inputs are whole files. The mutator takes one apart, changes the payload of a block and puts it together again; from
//! nothing it makes the files of some small scenes, of this very build.
#![no_main]

use std::{path::Path, sync::LazyLock};

use bytes::Bytes;
use glam::{DVec3, Vec2, Vec3};
use libfuzzer_sys::{fuzz_mutator, fuzz_target, fuzzer_mutate};
use luxel::{
    BakeOptions, Result,
    bake::{self, Kept, Run},
    lxt::{Container, Identity, Name, Transfer, Writer},
    options::{PatchSource, Reconstruct, Resolution},
    progress::Silent,
    scene::{
        Builder, Camera, Material, Opacity, OpacityMap, RawMaterial, RawMesh, SceneOverrides, SidesRule, Source,
        Texture, WorldLight,
    },
};

fuzz_target!(|data: &[u8]| {
    // Errors are what is asked for.
    let _ = relight(data);
});

fn open(data: &[u8]) -> Result<Container> {
    Container::of_bytes(Path::new("fuzz.lxt"), Bytes::copy_from_slice(data), Transfer::PURPOSE)
}

fn relight(data: &[u8]) -> Result<()> {
    let transfer = Transfer::of(open(data)?)?;
    let scene = transfer.scene(&SceneOverrides { sky: Some(Vec3::ONE), ..SceneOverrides::default() }, false)?;
    let mut kept = transfer.kept(&scene)?;
    let o = transfer.options();
    // Honest work, however much is asked for, is no finding.
    let patches = kept.simplified.as_ref().map_or(0, |s| s.patches.len());
    if patches < 500 && o.rays <= 64 && o.point_samples <= 16 && o.patch_samples <= 16 && o.gather_rays <= 64 {
        let mut run = Run { progress: &Silent, keeper: &mut (), deadline: None };
        bake::bake_with(&scene, o, &mut kept, &mut run)?;
    }
    Ok(())
}

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let mutated = open(&data[..size]).map(|file| mutate(&file, seed));
    let made = mutated.unwrap_or_else(|_| SEEDS[seed as usize % SEEDS.len()].clone());
    if made.len() > max_size {
        return size;
    }
    data[..made.len()].copy_from_slice(&made);
    made.len()
});

/// The file with one payload changed; now and then with two blocks' payloads swapped.
fn mutate(file: &Container, seed: u32) -> Vec<u8> {
    let mut blocks: Vec<(Name, u64, Vec<u8>)> =
        file.names().map(|(kind, n)| (kind, n, file.block(kind, n).map(|b| b.to_vec()).unwrap_or_default())).collect();
    if !blocks.is_empty() {
        let (one, other) = (seed as usize % blocks.len(), (seed >> 16) as usize % blocks.len());
        if (seed >> 8).is_multiple_of(16) {
            let payload = std::mem::take(&mut blocks[one].2);
            blocks[one].2 = std::mem::replace(&mut blocks[other].2, payload);
        } else {
            let payload = &mut blocks[one].2;
            let length = payload.len();
            payload.resize(length + 64, 0);
            let length = fuzzer_mutate(payload, length, length + 64);
            payload.truncate(length);
        }
    }
    let mut writer = Writer::new(Vec::new(), Transfer::PURPOSE).expect("memory can be written");
    for (kind, number, payload) in &blocks {
        writer.block(*kind, *number, &[payload]).expect("memory can be written");
    }
    writer.finish().expect("memory can be written")
}

static SEEDS: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    [PatchSource::Surfels, PatchSource::Faces, PatchSource::Decimated]
        .map(|source| seed(source).expect("a good scene"))
        .into()
});

/// The transfer file of a box with a textured lid and some of everything.
fn seed(patches: PatchSource) -> Result<Vec<u8>> {
    let mut builder = Builder::new("box");
    let texture = builder.add_texture(Texture { width: 2, height: 1, texels: vec![Vec3::X, Vec3::ONE] });
    let map = builder.add_opacity_map(OpacityMap { width: 1, height: 2, texels: vec![1.0, 0.7] });
    let surface =
        Material { name: "a".into(), albedo: Vec3::splat(0.5), albedo_texture: Some(texture), ..Material::default() };
    let opacity = Opacity { factor: 0.9, texture: Some(map), cutoff: Some(0.5) };
    let textured = builder.add_material(RawMaterial { surface, opacity });
    let surface = Material { name: "b".into(), emission: Vec3::ONE, double_sided: true, ..Material::default() };
    let plain = builder.add_material(RawMaterial { surface, ..RawMaterial::default() });
    let corners: Vec<DVec3> =
        (0..8).map(|i| DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64)).collect();
    let quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4]];
    builder.add_mesh(RawMesh {
        name: "walls".into(),
        positions: corners.clone(),
        triangles: quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
        material: plain,
        ..RawMesh::default()
    });
    builder.add_mesh(RawMesh {
        name: "lid".into(),
        positions: corners,
        normals: vec![Vec3::X; 8],
        uvs: (0..8).map(|i| Vec2::splat(i as f32 / 8.0)).collect(),
        colours: vec![Vec3::splat(0.8); 8],
        triangles: vec![[1, 5, 7], [1, 7, 3]],
        place: "line".into(),
        places: vec![3, 4],
        material: textured,
    });
    builder.add_light(WorldLight::Sun { direction: DVec3::NEG_ONE, irradiance: Vec3::ONE });
    builder.add_light(WorldLight::Point { position: DVec3::splat(0.5), intensity: Vec3::ONE, range: f64::INFINITY });
    builder.set_camera(Camera { position: DVec3::ZERO, target: DVec3::ONE, up: DVec3::Y, vertical_fov: 40.0 });
    let source = Source::new(builder, SidesRule::Two);
    let options = BakeOptions {
        resolution: Resolution::Grid(2),
        rays: 16,
        point_samples: 1,
        patch_samples: 1,
        gather_rays: 16,
        reconstruct: Reconstruct::Adaptive,
        patches,
        target_patches: Some(40),
        ..BakeOptions::default()
    };
    let scene = source.clone().build()?;
    let mut kept = Kept::default();
    bake::prepare(&scene, &options, &mut kept, &mut Run { progress: &Silent, keeper: &mut (), deadline: None })?;
    let mut writer = Writer::new(Vec::new(), Transfer::PURPOSE).expect("memory can be written");
    Transfer::fill(&mut writer, &Identity::new(&scene, &options)?, &source, &options, &kept)
        .expect("memory can be written");
    Ok(writer.finish().expect("memory can be written"))
}
