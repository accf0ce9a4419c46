//! Transfer files: scenes and patches come back as they were.

use std::{
    fs,
    path::{Path, PathBuf},
};

use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions, Error,
    bake::{self, Kept, Run},
    lxt::{Container, Identity, Name, Transfer, Writer, rows, simplified, source},
    options::{PatchSource, Resolution},
    progress::Silent,
    scene::{Builder, RawMaterial, RawMesh, SceneOverrides, SidesRule, Source, Texture, WorldLight},
    simplify::{self, Grid, Simplified},
    trace,
    transfer::{BlockWriter, Row, View},
};
use proptest::prelude::*;

const PURPOSE: Name = Name::new("test");

fn scenes() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let mut files: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|e| e == "toml" || e == "obj"));
    files.sort();
    files
}

/// What `write` writes, opened.
fn written(write: impl FnOnce(&mut Writer<Vec<u8>>) -> std::io::Result<()>) -> Container {
    let mut writer = Writer::new(Vec::new(), PURPOSE).unwrap();
    write(&mut writer).unwrap();
    Container::of_bytes(Path::new("some.lxt"), writer.finish().unwrap().into(), PURPOSE).unwrap()
}

#[test]
fn scenes_come_back_as_they_were_read() {
    for path in scenes() {
        let (read, _) = Source::load(&path, &SceneOverrides::default()).unwrap();
        let kept = source::read(&written(|w| source::write(w, &read))).unwrap();
        // Debug output of floats tells every bit but those of NaN.
        assert_eq!(
            format!("{:?}", kept.build().unwrap()),
            format!("{:?}", read.build().unwrap()),
            "{}",
            path.display()
        );
    }
}

#[test]
fn numbers_that_no_text_could_hold_survive() {
    let mut builder = Builder::new("odd \u{1F4A1}");
    let material = builder.add_material(RawMaterial::default());
    builder.materials_mut()[0].surface.albedo = Vec3::new(f32::NAN, f32::INFINITY, -0.0);
    let positions = vec![DVec3::ZERO, DVec3::X * (1.0 + f64::EPSILON), DVec3::Y, DVec3::splat(f64::NAN)];
    let triangles = vec![[0, 1, 2], [0, 1, 3]];
    builder.add_mesh(RawMesh { positions, triangles, material, ..RawMesh::default() });
    builder.add_light(WorldLight::Point { position: DVec3::Z, intensity: Vec3::ONE, range: f64::INFINITY });
    let read = Source::new(builder, SidesRule::Two);
    let kept = source::read(&written(|w| source::write(w, &read))).unwrap();
    assert_eq!(format!("{kept:?}"), format!("{read:?}"));
    assert_eq!(kept.build().unwrap().dropped.not_finite, 1);
}

#[test]
fn a_scene_that_does_not_fit_together_is_refused() {
    let refused = |fill: &dyn Fn(&mut Builder)| {
        let mut builder = Builder::new("wrong");
        fill(&mut builder);
        let error = source::read(&written(|w| source::write(w, &Source::new(builder, SidesRule::Auto)))).err().unwrap();
        assert!(matches!(error, Error::Input { .. }));
        error.to_string()
    };
    let texture = |width, height, texels| Texture { width, height, texels };
    for (message, fill) in [
        (
            "some.lxt: block scene 0: texture 0: 2 x 2 texels, but 3 values",
            &(|b: &mut Builder| _ = b.add_texture(texture(2, 2, vec![Vec3::ONE; 3]))) as &dyn Fn(&mut Builder),
        ),
        ("texture 0: 0 x 7 texels, but 0 values", &|b| _ = b.add_texture(texture(0, 7, vec![]))),
        ("not finite", &|b| _ = b.add_texture(texture(1, 1, vec![Vec3::NAN]))),
        ("light 0: radiance", &|b| b.add_light(WorldLight::Sky { radiance: Vec3::splat(-1.0) })),
    ] {
        let told = refused(fill);
        assert!(told.contains(message), "{told}");
    }
}

/// All that the rest of luxel sees of patches.
fn told(s: &Simplified) -> String {
    format!("{:?} {:?} {:?} {:?}", s.grid, s.geometry, s.fragments, s.patches)
}

#[test]
fn patches_of_every_kind_come_back() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.obj");
    let proxy = Some(path.with_file_name("cornell_proxy.obj"));
    let (scene, _) = luxel::scene::load(&path, &SceneOverrides { proxy, ..SceneOverrides::default() }).unwrap();
    use PatchSource::*;
    for patches in [Surfels, Faces, Decimated, Clustered, Proxy] {
        let options = BakeOptions { resolution: Resolution::Grid(12), patches, ..BakeOptions::default() };
        let tracer = trace::build(options.backend, &scene.geometry()).unwrap();
        let grid = Grid::new(&scene, options.resolution).unwrap();
        let made = simplify::simplify(&scene, grid, &options, &*tracer).unwrap();
        let file = written(|w| simplified::write(w, &made, &options));
        let mut kept = simplified::read(&file, &scene, &options).unwrap();
        // Colours are those of the scene that is baked.
        (kept.patches.albedo, kept.patches.emitted) = (made.patches.albedo.clone(), made.patches.emitted.clone());
        assert_eq!(told(&kept), told(&made), "{patches:?}");
        // Another grid is not what was asked for.
        let other = BakeOptions { resolution: Resolution::Grid(13), ..options };
        let error = simplified::read(&file, &scene, &other).err().unwrap().to_string();
        assert!(error.contains("block grid 0: is not the grid of the scene"), "{error}");
    }
}

#[test]
fn patches_that_do_not_fit_together_are_refused() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.obj");
    let (scene, _) = luxel::scene::load(&path, &SceneOverrides::default()).unwrap();
    let options = BakeOptions { resolution: Resolution::Grid(6), ..BakeOptions::default() };
    let tracer = trace::build(options.backend, &scene.geometry()).unwrap();
    let grid = Grid::new(&scene, options.resolution).unwrap();
    type Change = fn(&mut Simplified);
    let changes: [(&str, Change); 14] = [
        ("a patch that is not there", |s| s.fragments.patch[3] = [s.patches.len() as u32, 0]),
        ("not sorted by triangle", |s| s.fragments.triangle[0] = 1),
        ("triangles without any", |s| {
            let last = s.fragments.triangle[s.fragments.len() - 1];
            s.fragments.triangle.iter_mut().filter(|t| **t == last).for_each(|t| *t = last - 1);
        }),
        ("a voxel outside the grid", |s| s.fragments.voxel[0] = u64::MAX),
        ("arrays differ in length", |s| s.fragments.voxel.own().truncate(5)),
        ("runs that do not fit", |s| s.fragments.start[1] = 2),
        ("runs that do not fit", |s| s.fragments.start.own().clear()),
        ("a corner outside its triangle", |s| s.fragments.uv[7].x = f32::NAN),
        ("patches: arrays differ in length", |s| s.patches.centroid.own().truncate(5)),
        ("patches: not sorted by voxel", |s| s.patches.voxel[0] = *s.patches.voxel.last().unwrap()),
        ("an area that is negative", |s| s.patches.area[2] = -1.0),
        ("a place that is not finite", |s| s.patches.eye[2].y = f32::INFINITY),
        ("members are not the fragments' sides", |s| s.patches.members.swap(0, 40)),
        ("patches: runs that do not fit", |s| s.patches.start[0] = u32::MAX),
    ];
    for (message, change) in changes {
        let mut wrong = simplify::simplify(&scene, grid, &options, &*tracer).unwrap();
        change(&mut wrong);
        let file = written(|w| simplified::write(w, &wrong, &options));
        match simplified::read(&file, &scene, &options) {
            Err(Error::Input { message: told, .. }) => assert!(told.contains(message), "{told} (expected: {message})"),
            Err(other) => panic!("{other}"),
            Ok(_) => panic!("nobody noticed: {message}"),
        }
    }
}

#[test]
fn the_bytes_are_those_of_the_documentation() {
    let mut block = BlockWriter::default();
    let entries = [(2, 1), (130, 3), (400, 300)];
    block.push(&entries, Row { patch: 7, valid: 310, escaped: 6, hidden: 2, view: View::Outside, ..Row::default() });
    block.mark(&entries, &[(130, 1)]);
    let block = block.finish();
    let file = written(|w| {
        rows::write(w, rows::ROWS, 5, &block)?;
        w.value(Name::new("grid"), 0, &Grid { origin: DVec3::X, voxel_size: 0.5, dims: [1, 300, 3] })?;
        w.value(Name::new("options"), 0, &BakeOptions { only: vec!["a".into()], ..BakeOptions::default() })
    });
    let u32s = |numbers: &[u32]| numbers.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>();
    let head = u32s(&[1, 10, 1, 0]);
    let row = u32s(&[7, 310, 6, 2, 10, 1, 2]);
    // Steps 2, 128 and 270; counts 1, 3, and 300 announced by 255.
    let coded = [&[2, 1][..], &[0x80, 1, 3], &[0x8e, 2, 255, 0xac, 2]].concat();
    assert_eq!(*file.block(rows::ROWS, 5).unwrap(), [&head[..], &row, &coded, &[0b010]].concat());
    let grid = [&1.0_f64.to_le_bytes()[..], &[0; 16], &0.5_f64.to_le_bytes(), &[1, 0xac, 2, 3]].concat();
    assert_eq!(*file.block(Name::new("grid"), 0).unwrap(), grid);
    let options = [
        // Grid of 64, surfels, no target, 256 rays, smooth, 1024, direct, auto, normalised.
        &[0, 64, 0, 0, 0x80, 2, 0, 0x80, 8, 0, 0, 0][..],
        &60.0_f32.to_le_bytes(),
        &[64, 32],
        &1e-6_f64.to_le_bytes(),
        // Seed 0, skip, one mesh, estimate.
        &[0, 1, 1, 1, b'a', 1],
    ];
    assert_eq!(*file.block(Name::new("options"), 0).unwrap(), options.concat());
}

/// The transfer file of a small scene, block by block.
fn small() -> Vec<(Name, u64, Vec<u8>)> {
    let mut builder = Builder::new("tent");
    let material = builder.add_material(RawMaterial::default());
    let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    let triangles = vec![[0, 1, 2], [0, 2, 3], [0, 3, 1]];
    builder.add_mesh(RawMesh { name: "tent".into(), positions, triangles, material, ..RawMesh::default() });
    builder.add_light(WorldLight::Sky { radiance: Vec3::ONE });
    let source = Source::new(builder, SidesRule::Two);
    let options = BakeOptions { resolution: Resolution::Grid(2), rays: 16, ..BakeOptions::default() };
    let (scene, mut kept) = (source.clone().build().unwrap(), Kept::default());
    let mut run = Run { progress: &Silent, keeper: &mut (), deadline: None };
    bake::prepare(&scene, &options, &mut kept, &mut run).unwrap();
    let identity = Identity::new(&scene, &options).unwrap();
    let mut writer = Writer::new(Vec::new(), Transfer::PURPOSE).unwrap();
    Transfer::fill(&mut writer, &identity, &source, &options, &kept).unwrap();
    let file = Container::of_bytes(Path::new("x"), writer.finish().unwrap().into(), Transfer::PURPOSE).unwrap();
    file.names().map(|(kind, n)| (kind, n, file.block(kind, n).unwrap().to_vec())).collect()
}

/// A file of these blocks, with checksums that fit.
fn assembled(blocks: &[(Name, u64, Vec<u8>)]) -> Vec<u8> {
    let mut writer = Writer::new(Vec::new(), Transfer::PURPOSE).unwrap();
    blocks.iter().for_each(|(kind, number, payload)| writer.block(*kind, *number, &[payload]).unwrap());
    writer.finish().unwrap()
}

/// Reads all of a transfer file, and lights it if `light`.
fn read(bytes: Vec<u8>, light: bool) -> luxel::Result<()> {
    let transfer = Transfer::of(Container::of_bytes(Path::new("x"), bytes.into(), Transfer::PURPOSE)?)?;
    let scene = transfer.scene(&SceneOverrides::default(), false)?;
    let mut kept = transfer.kept(&scene)?;
    if light {
        let mut run = Run { progress: &Silent, keeper: &mut (), deadline: None };
        let bake = bake::bake_with(&scene, transfer.options(), &mut kept, &mut run)?;
        assert_eq!(bake.report.rows.cast, 0);
    }
    Ok(())
}

#[test]
fn a_transfer_file_without_a_block_or_with_swapped_ones_names_it() {
    let blocks = small();
    read(assembled(&blocks), true).unwrap();
    for i in 0..blocks.len() {
        let mut without = blocks.clone();
        let (kind, number, _) = without.remove(i);
        // Rows that are not there are cast: nothing is lost but time.
        if kind != rows::ROWS && kind != rows::AGAIN {
            let told = read(assembled(&without), false).unwrap_err().to_string();
            assert!(told.contains(&format!("block {kind} {number}: is missing")), "{told}");
        }
        for j in (0..i).filter(|&j| blocks[j].2 != blocks[i].2) {
            let mut swapped = blocks.clone();
            swapped[i].2.clone_from(&blocks[j].2);
            swapped[j].2.clone_from(&blocks[i].2);
            match read(assembled(&swapped), false) {
                Err(error) => assert!(matches!(error, Error::Input { .. }), "{error}"),
                // Arrays without a length before them may be taken for each other, which must be harmless.
                Ok(()) => {
                    let arrays = [i, j].map(|k| ["fragments", "patches"].map(Name::new).contains(&blocks[k].0));
                    assert_eq!(arrays, [true; 2], "{} for {}", blocks[i].0, blocks[j].0);
                    read(assembled(&swapped), true).ok();
                }
            }
        }
    }
}

#[test]
fn a_file_of_another_build_is_refused_by_name() {
    let mut blocks = small();
    let (kind, _, identity) = &mut blocks[0];
    assert_eq!(*kind, Name::new("identity"));
    let mut json: serde_json::Value = serde_json::from_slice(identity).unwrap();
    let here = json["build"]["instruction_set"].as_str().unwrap().to_string();
    json["build"]["instruction_set"] = "AVX-9".into();
    json["build"]["tracer"] = "embree 9.9.9".into();
    *identity = serde_json::to_vec(&json).unwrap();
    let told = read(assembled(&blocks), false).unwrap_err().to_string();
    assert!(told.contains("was made by luxel ") && told.contains("ray tracer embree 9.9.9 there, "), "{told}");
    assert!(told.ends_with(&format!("instruction set AVX-9 there, {here} here): make it anew")), "{told}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    /// What a hostile writer could do: payloads that are wrong, checksums that fit.
    #[test]
    fn wrong_payloads_are_refused_or_harmless(block in 0usize..64, bits in prop::collection::vec(0usize..1 << 20, 1..4)) {
        static SMALL: std::sync::LazyLock<Vec<(Name, u64, Vec<u8>)>> = std::sync::LazyLock::new(small);
        let mut blocks = SMALL.clone();
        let i = block % blocks.len();
        let payload = &mut blocks[i].2;
        for bit in bits {
            let bit = bit % (payload.len() * 8);
            payload[bit / 8] ^= 1 << (bit % 8);
        }
        // Anything but a panic.
        let _ = read(assembled(&blocks), false);
    }
}
