//! Transfer files: scenes and patches come back as they were.

use std::{
    fs,
    path::{Path, PathBuf},
};

use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions, Error,
    lxt::{Container, Name, Writer, simplified, source},
    options::{PatchSource, Resolution},
    scene::{Builder, RawMaterial, RawMesh, SceneOverrides, SidesRule, Source, Texture, WorldLight},
    simplify::{self, Grid, Simplified},
    trace,
};

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
fn patches_of_every_kind_come_back_with_their_colours() {
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
        let kept = simplified::read(&file, &scene, &options, &*tracer).unwrap();
        assert_eq!(told(&kept), told(&made), "{patches:?}");
        // Another grid is not what was asked for.
        let other = BakeOptions { resolution: Resolution::Grid(13), ..options };
        let error = simplified::read(&file, &scene, &other, &*tracer).err().unwrap().to_string();
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
        ("arrays differ in length", |s| s.fragments.voxel.truncate(5)),
        ("runs that do not fit", |s| s.fragments.start[1] = 2),
        ("runs that do not fit", |s| s.fragments.start.clear()),
        ("a corner outside its triangle", |s| s.fragments.uv[7].x = f32::NAN),
        ("patches: arrays differ in length", |s| s.patches.centroid.truncate(5)),
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
        match simplified::read(&file, &scene, &options, &*tracer) {
            Err(Error::Input { message: told, .. }) => assert!(told.contains(message), "{told} (expected: {message})"),
            Err(other) => panic!("{other}"),
            Ok(_) => panic!("nobody noticed: {message}"),
        }
    }
}
