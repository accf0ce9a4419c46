//! The settings of a bake.

use serde::{Deserialize, Serialize};

/// Size of the voxels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Resolution {
    /// This many voxels along the longest side of the scene.
    Grid(u32),
    /// Voxels of this size, in scene units.
    Voxel(f64),
}

/// What the patches of the radiosity system are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PatchSource {
    /// Pieces of the real surfaces, grouped by voxel and dominant normal axis.
    Surfels,
    /// The paper's method to the letter: equal square voxel faces.
    Faces,
    /// Triangles of the scene's mesh, simplified by edge collapse.
    Decimated,
    /// Triangles of the scene's mesh, simplified by vertex clustering.
    Clustered,
    /// Triangles of [`Scene::proxy`](crate::Scene::proxy), a hand-made simplified mesh.
    Proxy,
}

/// How patch light is carried to vertices and points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reconstruct {
    /// Local linear least squares over visible same-facing patches.
    Smooth,
    /// The paper's four nearest patches, weighted by inverse distance.
    Nearest4,
    /// Final gather: every point asks the patches that it sees, by rays of its own.
    Gather,
    /// `Smooth`, and `Gather` at the points where the patches nearby do not agree on the light.
    Adaptive,
}

impl Reconstruct {
    /// Whether points may cast rays of their own for the light of patches.
    pub fn gathers(self) -> bool {
        matches!(self, Reconstruct::Gather | Reconstruct::Adaptive)
    }
}

/// How primary light enters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Primary {
    /// Sampled at patches and vertices; radiosity carries the secondary light (the paper's figures 4-8).
    Direct,
    /// Emitting surfaces enter the radiosity system as patches (the paper's figure 9).
    Radiosity,
}

/// Which ray tracer runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Backend {
    /// Embree where it is compiled in, else obvhs.
    Auto,
    /// Embree; an error where it is not compiled in.
    Embree,
    /// The pure-Rust BVH of obvhs.
    Bvh,
    /// Every triangle against every ray: the test oracle.
    Brute,
}

/// Step 4 of the paper: how polygon colours in a voxel combine to the colour of a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaceColour {
    /// Mean, weighted by projected area.
    Normalised,
    /// The literal sum of colour x projected area / face area (at most 1).
    Literal,
}

/// The settings of a bake. Defaults aim at about 1 % error of indirect irradiance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BakeOptions {
    /// Voxel size.
    pub resolution: Resolution,
    /// Patch source.
    pub patches: PatchSource,
    /// Patches to aim at where they are triangles of a simplified mesh; `None`: so many that their mean area is that of a
    /// voxel face.
    pub target_patches: Option<u32>,
    /// Form-factor rays a patch; a power of two, 16 ..= 65536.
    pub rays: u32,
    /// Interpolation to vertices and points.
    pub reconstruct: Reconstruct,
    /// Rays of a point that gathers, 16 ..= 65536.
    pub gather_rays: u32,
    /// Treatment of primary light.
    pub primary: Primary,
    /// Ray tracer.
    pub backend: Backend,
    /// Colour rule of `PatchSource::Faces`.
    pub face_colour: FaceColour,
    /// Largest angle between the normals of a vertex and a patch it takes light from, degrees.
    pub normal_threshold: f32,
    /// Shadow rays a vertex or point for area lights and sky.
    pub point_samples: u32,
    /// Shadow rays a patch for area lights and sky.
    pub patch_samples: u32,
    /// Largest residual of the solution, relative to the largest source term.
    pub tolerance: f64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Leave out what the scene does not need; the report lists what, and what it costs.
    pub skip: bool,
    /// Names of the meshes whose light is wanted; empty: all.
    pub only: Vec<String>,
    /// Estimate the error of the result.
    pub estimate: bool,
}

impl Default for BakeOptions {
    fn default() -> Self {
        BakeOptions {
            resolution: Resolution::Grid(64),
            patches: PatchSource::Surfels,
            target_patches: None,
            rays: 256,
            reconstruct: Reconstruct::Smooth,
            gather_rays: 1024,
            primary: Primary::Direct,
            backend: Backend::Auto,
            face_colour: FaceColour::Normalised,
            normal_threshold: 60.0,
            point_samples: 64,
            patch_samples: 32,
            tolerance: 1e-6,
            seed: 0,
            skip: true,
            only: Vec::new(),
            estimate: true,
        }
    }
}
