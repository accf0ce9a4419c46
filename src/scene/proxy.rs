//! A hand-made simplified mesh that stands for the scene when light is exchanged.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize, Serializer};

use super::{Builder, Scene, SidesRule, load::read_mesh};
use crate::{Error, Result};

/// A simplified mesh, in the local frame of the scene that it stands for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Proxy {
    /// The file.
    #[serde(serialize_with = "lossy")]
    pub path: PathBuf,
    /// Vertex positions.
    #[serde(with = "crate::lxt::raw")]
    pub positions: Vec<Vec3>,
    /// Vertex indices.
    #[serde(with = "crate::lxt::raw")]
    pub triangles: Vec<[u32; 3]>,
    /// Mesh of every triangle.
    #[serde(with = "crate::lxt::raw")]
    pub mesh: Vec<u32>,
    /// Names of the meshes.
    pub meshes: Vec<String>,
    /// Faces of the file that were left out: without area, not finite, transparent, or lying on others.
    pub dropped: usize,
}

/// A proxy may stand out of the scene's bounds by this share of their longest side.
const MARGIN: f64 = 0.5;

impl Proxy {
    /// Reads an OBJ, glTF or GLB file in the world coordinates of `scene`. Its materials, lights and winding do not
    /// count: patches take colour and sides from the surfaces that they stand for.
    ///
    /// # Errors
    /// The file cannot be read or is wrong, holds no triangle with an area, or lies elsewhere than the scene.
    pub fn read(path: &Path, scene: &Scene) -> Result<Proxy> {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let mut builder = Builder::new(name);
        read_mesh(path, &mut builder)?;
        let own = builder.build(SidesRule::One).map_err(|e| match e {
            Error::Scene(m) | Error::Option(m) => Error::input(path, "", format!("as a proxy: {m}")),
            other => other,
        })?;
        let positions: Vec<DVec3> = own.positions.iter().map(|p| own.frame.to_world(*p)).collect();
        let (low, high) = bounds(positions.iter().copied());
        let (scene_low, scene_high) = bounds(scene.positions.iter().map(|p| scene.frame.to_world(*p)));
        let margin = MARGIN * (scene_high - scene_low).max_element();
        if low.cmplt(scene_low - margin).any() || high.cmpgt(scene_high + margin).any() {
            return Err(Error::input(
                path,
                "",
                format!(
                    "the proxy spans {low} to {high}, but the scene {scene_low} to {scene_high}: model it in the \
                     scene's world coordinates and unit, moved and scaled as the scene file does its meshes"
                ),
            ));
        }
        Ok(Proxy {
            path: path.into(),
            positions: positions.into_iter().map(|p| scene.frame.to_local(p)).collect(),
            triangles: own.triangles.iter().map(|t| t.vertices).collect(),
            mesh: own.triangles.iter().map(|t| t.mesh).collect(),
            meshes: own.meshes,
            dropped: own.dropped.total(),
        })
    }

    /// What [`Proxy::read`] makes sure of.
    pub(super) fn check(&self) -> std::result::Result<(), String> {
        let vertices = self.positions.len();
        let fits = self.triangles.iter().flatten().all(|&v| (v as usize) < vertices)
            && self.mesh.len() == self.triangles.len()
            && self.mesh.iter().all(|&m| (m as usize) < self.meshes.len())
            && self.positions.iter().all(|p| p.is_finite());
        if fits { Ok(()) } else { Err("the proxy does not fit together".into()) }
    }

    /// The error that triangle `t` makes; its corners are told in world coordinates.
    pub(crate) fn wrong(&self, scene: &Scene, t: usize, message: &str) -> Error {
        // Local coordinates are good for seven digits.
        let decimals = (6.0 - scene.frame.scale.log10().floor()).clamp(0.0, 17.0) as usize;
        let [a, b, c] = self.triangles[t].map(|v| {
            let p = scene.frame.to_world(self.positions[v as usize]);
            // Without the sign of what rounds to zero.
            let [x, y, z] = p.to_array().map(|x| if x.abs() < 0.5 * 0.1_f64.powi(decimals as i32) { 0.0 } else { x });
            format!("({x:.decimals$} {y:.decimals$} {z:.decimals$})")
        });
        let place = format!("mesh \"{}\", triangle {a}, {b}, {c}", self.meshes[self.mesh[t] as usize]);
        Error::input(&self.path, place, message)
    }
}

/// Paths are for messages: those that are no text lose what cannot be shown.
fn lossy<S: Serializer>(path: &Path, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
}

fn bounds(points: impl Iterator<Item = DVec3>) -> (DVec3, DVec3) {
    points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)))
}
