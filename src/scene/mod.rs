//! What is baked: surfaces, materials, lights, in one normalised frame.

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

mod builder;
pub mod check;
mod clean;
mod clean_material;
mod coincident;
mod cutout;
mod environment;
mod facing;
mod file;
mod gltf;
mod gltf_data;
mod gltf_material;
mod image;
pub mod light;
mod load;
pub mod material;
mod mtl;
mod obj;
mod obj_scan;
mod path;
mod point;
mod polygon;
mod proxy;
mod raw;
mod shell;
pub mod sides;
mod source;
mod topology;
mod weld;
mod world_light;

pub(crate) use builder::list;
pub use builder::{Builder, Mark};
pub use check::{MaterialCheck, SceneCheck};
pub use clean::Dropped;
pub use file::FileSettings;
pub use image::OpacityMap;
pub use light::Light;
pub use load::{SceneOverrides, load};
pub use material::{Material, Texture};
pub use point::SurfacePoint;
pub use proxy::Proxy;
pub use raw::{Opacity, RawMaterial, RawMesh};
pub use sides::{SideDecision, SideKind, SidesRule};
pub use source::Source;
pub use world_light::WorldLight;

use crate::trace::Geometry;

/// The map between world coordinates and the local frame that all computation happens in.
///
/// `world = origin + scale * local`; `scale` is a power of two, chosen so that the surfaces fit in
/// [-0.5, 0.5]^3. All lengths inside luxel are local, which makes every tolerance relative to the scene and keeps f32
/// accurate wherever the scene lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// World position of the local origin.
    pub origin: DVec3,
    /// World units a local unit; a power of two.
    pub scale: f64,
}

impl Frame {
    /// Local to world.
    pub fn to_world(&self, local: Vec3) -> DVec3 {
        self.origin + self.scale * local.as_dvec3()
    }

    /// World to local.
    pub fn to_local(&self, world: DVec3) -> Vec3 {
        ((world - self.origin) / self.scale).as_vec3()
    }
}

/// Distance, in local units, that ray origins are moved off their surface: 24 ulp of the largest coordinate (0.5).
pub const RAY_OFFSET: f32 = 24.0 * 0.5 * f32::EPSILON;

/// One triangle. The front is the side that its normal `(v1 - v0) x (v2 - v0)` points to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// Indices of the positions.
    pub vertices: [u32; 3],
    /// Index of the material.
    pub material: u32,
    /// Index of the mesh it came from.
    pub mesh: u32,
    /// Whether its back receives and reflects light too. Backs of one-sided triangles lie inside or behind objects:
    /// what a ray sees there says that its origin is hidden.
    pub two_sided: bool,
    /// Whether its back emits too, if its material emits.
    pub emits_back: bool,
}

/// What the corners of triangles carry besides positions; each array is empty or has one entry a triangle.
#[derive(Clone, Debug, Default)]
pub struct Corners {
    /// Shading normals, unit length, on the side of the geometric normal. Empty: flat.
    pub normals: Vec<[Vec3; 3]>,
    /// Texture coordinates; v = 0 is the top row. Empty: no material has a texture.
    pub uvs: Vec<[Vec2; 3]>,
    /// Vertex colours that multiply the albedo. Empty: white.
    pub colours: Vec<[Vec3; 3]>,
}

/// A camera that looks from `position` to `target`; world coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Where it stands.
    pub position: DVec3,
    /// What it looks at.
    pub target: DVec3,
    /// Which way is up.
    pub up: DVec3,
    /// Vertical angle of view, degrees.
    pub vertical_fov: f64,
}

/// A cleaned scene, ready to bake: every triangle has a positive area, finite corners and a decided orientation.
#[derive(Clone, Debug)]
pub struct Scene {
    /// For messages and outputs.
    pub name: String,
    /// Local frame.
    pub frame: Frame,
    /// Vertex positions, local.
    pub positions: Vec<Vec3>,
    /// Opaque triangles; transparent ones are not in the scene.
    pub triangles: Vec<Triangle>,
    /// Corner attributes.
    pub corners: Corners,
    /// Materials; index 0 .. are named by the triangles.
    pub materials: Vec<Material>,
    /// Textures that materials name.
    pub textures: Vec<Texture>,
    /// Mesh names, for messages.
    pub meshes: Vec<String>,
    /// Lights that are not surfaces.
    pub lights: Vec<Light>,
    /// The camera of the preview, if the scene has one.
    pub camera: Option<Camera>,
    /// What the reader should know: dropped faces, clamped colours, decisions on sides.
    pub warnings: Vec<String>,
    /// What was decided on the sides of every connected component.
    pub sides: Vec<SideDecision>,
    /// What did not enter the scene.
    pub dropped: Dropped,
    /// A hand-made simplified mesh that can take its place when light is exchanged.
    pub proxy: Option<Proxy>,
}

/// 64 stratified points of a triangle, as barycentric weights of its second and third corner.
pub(crate) fn triangle_samples() -> [(f32, f32); 64] {
    std::array::from_fn(|i| crate::sampling::triangle((i % 8) as f32 / 8.0 + 0.0625, (i / 8) as f32 / 8.0 + 0.0625))
}

impl Scene {
    /// The three corners of triangle `t`, local.
    pub fn corners_of(&self, t: usize) -> [Vec3; 3] {
        self.triangles[t].vertices.map(|v| self.positions[v as usize])
    }

    /// Unit geometric normal of triangle `t`.
    pub fn normal(&self, t: usize) -> Vec3 {
        let [a, b, c] = self.corners_of(t).map(Vec3::as_dvec3);
        (b - a).cross(c - a).normalize().as_vec3()
    }

    /// Unit geometric normals of all triangles.
    pub fn normals(&self) -> Vec<Vec3> {
        (0..self.triangles.len()).into_par_iter().map(|t| self.normal(t)).collect()
    }

    /// Area of triangle `t`, local units squared.
    pub fn area(&self, t: usize) -> f64 {
        let [a, b, c] = self.corners_of(t).map(Vec3::as_dvec3);
        0.5 * (b - a).cross(c - a).length()
    }

    /// What rays are traced against; triangle ids are those of the scene.
    pub fn geometry(&self) -> Geometry {
        Geometry { positions: self.positions.clone(), triangles: self.triangles.iter().map(|t| t.vertices).collect() }
    }

    /// Albedo of triangle `t` where it is the same everywhere on it.
    pub fn constant_albedo(&self, t: usize) -> Option<Vec3> {
        let m = self.material(t);
        (m.albedo_texture.is_none() && self.corners.colours.is_empty()).then_some(m.albedo)
    }

    /// Albedo of triangle `t` at barycentric weights `u`, `v` of its second and third corner.
    pub fn albedo(&self, t: usize, u: f32, v: f32) -> Vec3 {
        let m = self.material(t);
        let mut albedo = m.albedo;
        if let Some(texture) = m.albedo_texture {
            albedo *= self.textures[texture as usize].sample(self.uv(t, u, v));
        }
        if let Some([a, b, c]) = self.corners.colours.get(t) {
            albedo *= *a * (1.0 - u - v) + *b * u + *c * v;
        }
        albedo.clamp(Vec3::ZERO, Vec3::splat(material::ALBEDO_MAX))
    }

    /// Radiance that triangle `t` emits from its front (from both sides if it `emits_back`), W/m2/sr: the mean over it.
    pub fn emission(&self, t: usize) -> Vec3 {
        let m = self.material(t);
        match m.emission_texture {
            Some(texture) if m.emission != Vec3::ZERO => {
                // 64 stratified points: a lamp's texture is rarely finer.
                let texture = &self.textures[texture as usize];
                let mean: Vec3 = triangle_samples().iter().map(|&(u, v)| texture.sample(self.uv(t, u, v))).sum();
                m.emission * mean / 64.0
            }
            _ => m.emission,
        }
    }

    /// Turns triangle `t` around, so that its back becomes its front.
    pub(crate) fn turn(&mut self, t: usize) {
        self.triangles[t].vertices.swap(1, 2);
        if let Some(normals) = self.corners.normals.get_mut(t) {
            normals.swap(1, 2);
            *normals = normals.map(|n| -n);
        }
        if let Some(uvs) = self.corners.uvs.get_mut(t) {
            uvs.swap(1, 2);
        }
        if let Some(colours) = self.corners.colours.get_mut(t) {
            colours.swap(1, 2);
        }
    }

    /// Whether anything sends out light.
    pub fn has_light(&self) -> bool {
        self.lights.iter().any(Light::gives_light) || (0..self.triangles.len()).any(|t| self.emission(t) != Vec3::ZERO)
    }

    /// What to say about a scene that has no light: the ways to add some.
    pub fn no_light_message(&self) -> String {
        format!(
            "scene \"{}\" has no light; add some: --sky R,G,B (radiance of the sky), --sun X,Y,Z:R,G,B (direction of \
             travel : irradiance), --point X,Y,Z:R,G,B (position : radiant intensity), --emit MATERIAL=R,G,B (radiance \
             of a material), or lights in a scene file",
            self.name
        )
    }

    fn material(&self, t: usize) -> &Material {
        &self.materials[self.triangles[t].material as usize]
    }

    fn uv(&self, t: usize, u: f32, v: f32) -> Vec2 {
        self.corners.uvs.get(t).map_or(Vec2::ZERO, |[a, b, c]| *a * (1.0 - u - v) + *b * u + *c * v)
    }
}
