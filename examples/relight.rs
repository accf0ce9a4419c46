//! Carries a light about a baked room and reads the light of its vertices, frame by frame: `cargo run --release --example relight`.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions, Relighter, Result, Scene,
    options::Resolution,
    progress::Silent,
    scene::{Builder, Material, RawMaterial, RawMesh, SidesRule, WorldLight},
};

const FRAMES: usize = 24;

fn main() -> Result<()> {
    let frames = tour()?;
    println!("| frame | mean direct, W/m2 | mean indirect, W/m2 | sweeps | ms |\n|-|-|-|-|-|");
    for (k, f) in frames.iter().enumerate() {
        println!("| {k} | {:.4} | {:.4} | {} | {:.2} |", f.direct, f.indirect, f.sweeps, 1e3 * f.seconds);
    }
    Ok(())
}

/// What was seen of a frame.
pub struct Seen {
    /// Means over the vertices, W/m2.
    pub direct: f32,
    pub indirect: f32,
    pub sweeps: usize,
    /// Of all but the vertices' direct light.
    pub seconds: f64,
}

/// A square lamp goes round below the ceiling of a room with a block, and turns to the middle as it goes.
pub fn tour() -> Result<Vec<Seen>> {
    let scene = room()?;
    // All rows, so that every light that comes finds what it needs; no estimate of the error, which frames do not have.
    let options =
        BakeOptions { resolution: Resolution::Grid(32), skip: false, estimate: false, ..BakeOptions::default() };
    let bake = luxel::bake(&scene, &options, &Silent)?;
    // From here on everything happens in memory. Light number 0 is the scene's only one.
    let mut relighter = Relighter::new(scene, bake)?;
    let mut frames = Vec::new();
    for k in 0..FRAMES {
        relighter.set_light(0, lamp(TAU * k as f64 / FRAMES as f64))?;
        let frame = relighter.frame();
        let mean = |light: &[Vec3]| light.iter().map(|e| e.element_sum() / 3.0).sum::<f32>() / light.len() as f32;
        frames.push(Seen {
            indirect: mean(relighter.indirect()),
            direct: mean(relighter.direct()),
            sweeps: frame.sweeps,
            seconds: frame.seconds.iter().sum(),
        });
    }
    Ok(frames)
}

/// A lamp of 0.4 x 0.4 m, radiance 20.
fn lamp(turn: f64) -> WorldLight {
    let (sin, cos) = turn.sin_cos();
    let centre = DVec3::new(1.0 + 0.6 * cos, 1.7, 1.0 + 0.6 * sin);
    // It faces down and a little inwards: the edges' cross product is the way it shines.
    let (along, across) = (DVec3::new(-sin, 0.0, cos), DVec3::new(cos, -0.4, sin).normalize());
    let (edge_u, edge_v) = (0.4 * across, 0.4 * along);
    WorldLight::Rectangle { corner: centre - 0.5 * (edge_u + edge_v), edge_u, edge_v, radiance: Vec3::splat(20.0) }
}

/// 2 x 2 x 2 m with a red wall and a block in the middle, and the lamp.
fn room() -> Result<Scene> {
    let mut builder = Builder::new("room");
    let mut material = |name: &str, albedo: Vec3| {
        let surface = Material { name: name.into(), albedo, ..Material::default() };
        builder.add_material(RawMaterial { surface, ..RawMaterial::default() })
    };
    let (white, red) = (material("white", Vec3::splat(0.7)), material("red", Vec3::new(0.6, 0.05, 0.05)));
    let mut rectangle = |name: &str, corner: DVec3, u: DVec3, v: DVec3, material: u32| {
        builder.add_mesh(RawMesh {
            name: name.into(),
            positions: vec![corner, corner + u, corner + u + v, corner + v],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material,
            ..RawMesh::default()
        });
    };
    // Walls face inwards, the sides of the block outwards.
    let (o, x, y, z) = (DVec3::ZERO, 2.0 * DVec3::X, 2.0 * DVec3::Y, 2.0 * DVec3::Z);
    rectangle("floor", o, z, x, white);
    rectangle("ceiling", o + y, x, z, white);
    rectangle("left", o, y, z, red);
    rectangle("right", o + x, z, y, white);
    rectangle("back", o, x, y, white);
    rectangle("front", o + z, y, x, white);
    let (o, x, y, z) = (DVec3::new(0.7, 0.5, 0.7), 0.6 * DVec3::X, 0.4 * DVec3::Y, 0.6 * DVec3::Z);
    for (corner, u, v) in [(o, x, z), (o + y, z, x), (o, z, y), (o + x, y, z), (o, y, x), (o + z, x, y)] {
        rectangle("block", corner, u, v, white);
    }
    builder.add_light(lamp(0.0));
    builder.build(SidesRule::One)
}
