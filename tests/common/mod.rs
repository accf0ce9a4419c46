//! Scenes with known answers, and what is asked of their bakes.
#![allow(dead_code)] // Each test binary uses a part.

use glam::{DVec3, Vec3};
#[allow(unused_imports)] // As above.
pub use luxel::selftest::{rows::mesh_of, world::rotation};
use luxel::{
    BakeOptions, Scene,
    bake::Bake,
    options::{PatchSource, Resolution},
    scene::{SidesRule, SurfacePoint},
    selftest::world::Placement,
};

/// A scene under construction; [`World::build`] panics where the library's returns an error.
pub struct World(luxel::selftest::World);

impl std::ops::Deref for World {
    type Target = luxel::selftest::World;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl std::ops::DerefMut for World {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.0
    }
}

impl From<luxel::selftest::World> for World {
    fn from(world: luxel::selftest::World) -> World {
        World(world)
    }
}

impl World {
    pub fn new() -> World {
        luxel::selftest::World::new().into()
    }

    /// The scene, one-sided as wound, and the map from the coordinates it was built in to the local frame.
    pub fn build(self) -> Stage {
        self.build_by(SidesRule::One)
    }

    /// As [`World::build`], with another rule for sides.
    pub fn build_by(self, rule: SidesRule) -> Stage {
        let (scene, placement) = self.0.build_by(rule).expect("a valid scene");
        Stage { scene, placement }
    }
}

/// A scene and where its own coordinates went.
pub struct Stage {
    pub scene: Scene,
    placement: Placement,
}

impl Stage {
    /// Surface point in the coordinates that the scene was built in.
    pub fn point(&self, position: [f64; 3], normal: [f64; 3]) -> SurfacePoint {
        self.placement.point(&self.scene, position, normal)
    }

    /// Where a local point lies in the coordinates that the scene was built in.
    pub fn as_built(&self, local: Vec3) -> DVec3 {
        self.placement.as_built(&self.scene, local)
    }

    pub fn bake(&self, options: &BakeOptions) -> Bake {
        luxel::bake(&self.scene, options, &luxel::progress::Silent).expect("a bake")
    }

    /// Area of the surfaces, world units.
    pub fn area(&self) -> f64 {
        luxel::selftest::enclosures::area(&self.scene)
    }
}

pub fn options(grid: u32, rays: u32) -> BakeOptions {
    BakeOptions { resolution: Resolution::Grid(grid), rays, estimate: false, ..BakeOptions::default() }
}

pub fn faces(options: BakeOptions) -> BakeOptions {
    BakeOptions { patches: PatchSource::Faces, ..options }
}

/// Mean of the first channel of a value of the patches, by area.
pub fn patch_mean(bake: &Bake, values: &[Vec3]) -> f64 {
    luxel::selftest::rows::patch_mean(bake, values).x
}

/// Mean of a value of the vertices over the surface of the split mesh, by area.
pub fn vertex_mean(bake: &Bake, values: &[Vec3]) -> f64 {
    let (mut sum, mut area) = (0.0, 0.0);
    for t in &bake.mesh.triangles {
        let [a, b, c] = t.map(|v| bake.mesh.positions[v as usize].as_dvec3());
        let own = (b - a).cross(c - a).length();
        sum += own * t.iter().map(|&v| values[v as usize].x as f64).sum::<f64>() / 3.0;
        area += own;
    }
    sum / area
}

/// The irradiance of the first channel.
pub fn red(values: &[Vec3]) -> Vec<f64> {
    values.iter().map(|v| v.x as f64).collect()
}

/// Largest relative error.
pub fn worst(got: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(got.len(), expected.len());
    got.iter().zip(expected).map(|(g, e)| (g / e - 1.0).abs()).fold(0.0, f64::max)
}
