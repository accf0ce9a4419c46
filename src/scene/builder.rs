//! Collects what a scene is made of.

use glam::DAffine3;
use serde::{Deserialize, Serialize};

use super::{Camera, RawMaterial, RawMesh, Texture, WorldLight, image::OpacityMap};

/// Collects what a scene is made of; [`Builder::build`] cleans it.
///
/// ```
/// use glam::{DVec3, Vec3};
/// use luxel::scene::{Builder, Material, RawMaterial, RawMesh, SidesRule, WorldLight};
///
/// let mut builder = Builder::new("floor");
/// let grey = Material { name: "grey".into(), albedo: Vec3::splat(0.5), ..Material::default() };
/// let grey = builder.add_material(RawMaterial { surface: grey, ..RawMaterial::default() });
/// builder.add_mesh(RawMesh {
///     name: "floor".into(),
///     positions: vec![DVec3::ZERO, DVec3::Z, DVec3::X],
///     triangles: vec![[0, 1, 2]],
///     material: grey,
///     ..RawMesh::default()
/// });
/// builder.add_light(WorldLight::Sky { radiance: Vec3::ONE });
/// let scene = builder.build(SidesRule::Auto)?;
/// assert_eq!(scene.triangles.len(), 1);
/// # luxel::Result::Ok(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Builder {
    pub(super) name: String,
    pub(super) meshes: Vec<RawMesh>,
    pub(super) materials: Vec<RawMaterial>,
    pub(super) textures: Vec<Texture>,
    pub(super) opacity_maps: Vec<OpacityMap>,
    pub(super) lights: Vec<WorldLight>,
    pub(super) camera: Option<Camera>,
    pub(super) warnings: Vec<String>,
    pub(super) short_faces: usize,
}

/// How much a builder holds at some moment; see [`Builder::transform_since`].
#[derive(Clone, Copy, Debug)]
pub struct Mark {
    meshes: usize,
    lights: usize,
    has_camera: bool,
}

impl Builder {
    /// An empty scene.
    pub fn new(name: impl Into<String>) -> Builder {
        Builder { name: name.into(), ..Builder::default() }
    }

    /// Adds a mesh.
    pub fn add_mesh(&mut self, mesh: RawMesh) {
        self.meshes.push(mesh);
    }

    /// Adds a material and returns its index.
    pub fn add_material(&mut self, material: RawMaterial) -> u32 {
        self.materials.push(material);
        self.materials.len() as u32 - 1
    }

    /// Adds a texture and returns its index. It must have width x height > 0 texels.
    pub fn add_texture(&mut self, texture: Texture) -> u32 {
        self.textures.push(texture);
        self.textures.len() as u32 - 1
    }

    /// Adds an opacity map and returns its index. It must have width x height > 0 texels.
    pub fn add_opacity_map(&mut self, map: OpacityMap) -> u32 {
        self.opacity_maps.push(map);
        self.opacity_maps.len() as u32 - 1
    }

    /// Adds a light.
    pub fn add_light(&mut self, light: WorldLight) {
        self.lights.push(light);
    }

    /// Sets the camera.
    pub fn set_camera(&mut self, camera: Camera) {
        self.camera = Some(camera);
    }

    /// Sets the camera if there is none yet.
    pub fn suggest_camera(&mut self, camera: Camera) {
        self.camera.get_or_insert(camera);
    }

    /// Adds something the reader should know.
    pub fn warn(&mut self, warning: String) {
        self.warnings.push(warning);
    }

    /// Counts faces with fewer than three corners, which a loader left out and warned of.
    pub(crate) fn count_short_faces(&mut self, n: usize) {
        self.short_faces += n;
    }

    /// The materials so far.
    pub fn materials_mut(&mut self) -> &mut [RawMaterial] {
        &mut self.materials
    }

    /// How much there is now.
    pub fn mark(&self) -> Mark {
        Mark { meshes: self.meshes.len(), lights: self.lights.len(), has_camera: self.camera.is_some() }
    }

    /// Moves everything added since `mark`; a mirroring transform turns the triangles around, so that fronts stay fronts.
    pub fn transform_since(&mut self, mark: Mark, transform: &DAffine3) {
        for mesh in &mut self.meshes[mark.meshes..] {
            mesh.transform(transform);
        }
        for light in &mut self.lights[mark.lights..] {
            light.transform(transform);
        }
        if let (Some(camera), false) = (&mut self.camera, mark.has_camera) {
            camera.position = transform.transform_point3(camera.position);
            camera.target = transform.transform_point3(camera.target);
            camera.up = transform.transform_vector3(camera.up);
        }
    }

    /// Gives all meshes added since `mark` the material `material`.
    pub fn set_material_since(&mut self, mark: Mark, material: u32) {
        for mesh in &mut self.meshes[mark.meshes..] {
            mesh.material = material;
        }
    }
}

/// The first `most` of `items`, and how many more there are.
pub(crate) fn list(items: &[String], most: usize) -> String {
    let mut text = items[..items.len().min(most)].join("; ");
    if items.len() > most {
        text.push_str(&format!("; and {} more", items.len() - most));
    }
    text
}
