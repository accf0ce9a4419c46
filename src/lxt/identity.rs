//! What rows depend on, as hashes.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::BuildId;
use crate::{
    BakeOptions, Error, Result, Scene,
    options::{Backend, PatchSource},
};

/// What parts of one bake must have in common: which build made them, of which surfaces.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// The build.
    pub build: BuildId,
    /// The ray tracer that was asked for.
    pub backend: Backend,
    /// Hash of the surfaces: see [`Identity::surfaces`].
    pub surfaces: String,
}

impl Identity {
    /// Of this process and a scene.
    ///
    /// # Errors
    /// Those of [`BuildId::of`].
    pub fn new(scene: &Scene, options: &BakeOptions) -> Result<Identity> {
        let backend = options.backend;
        Ok(Identity { build: BuildId::of(backend)?, backend, surfaces: Identity::surfaces(scene) })
    }

    /// Whether this process would compute the same bits.
    ///
    /// # Errors
    /// [`Error::Input`] for the file `path` that this is the identity of: what differs, by name.
    pub fn check_build(&self, path: &Path) -> Result<()> {
        let other = |what: String| {
            let message = format!("was made by {}, and the bits would differ ({what}): make it anew", self.build);
            Error::input(path, "", message)
        };
        let here = BuildId::of(self.backend).map_err(|e| other(e.to_string()))?;
        self.build.difference(&here).map_or(Ok(()), |difference| Err(other(difference)))
    }

    /// Hash of all that patches and rows depend on in a scene, hexadecimal: corners and sides of the triangles, and the
    /// proxy.
    pub fn surfaces(scene: &Scene) -> String {
        let mut hasher = blake3::Hasher::new();
        let mut add = |bytes: &[u8]| {
            hasher.update(&(bytes.len() as u64).to_le_bytes());
            hasher.update(bytes);
        };
        add(bytemuck::cast_slice(&scene.positions));
        let corners = scene.triangles.iter().map(|t| [t.vertices[0], t.vertices[1], t.vertices[2], t.two_sided as u32]);
        add(bytemuck::cast_slice(&corners.collect::<Vec<[u32; 4]>>()));
        add(bytemuck::bytes_of(&scene.frame.scale));
        if let Some(proxy) = &scene.proxy {
            add(bytemuck::cast_slice(&proxy.positions));
            add(bytemuck::cast_slice(&proxy.triangles));
        }
        hasher.finalize().to_hex().to_string()
    }

    /// A hash of this and of the settings that rows depend on: what they are kept under. Lights, colours, samples and
    /// reconstruction are not among these.
    ///
    /// # Errors
    /// None in practice: plain data always serialises.
    pub fn key(&self, options: &BakeOptions) -> Result<blake3::Hash> {
        use PatchSource::{Faces, Surfels};
        let BakeOptions { resolution, patches, target_patches, rays, seed, skip, only, .. } = options;
        let target_patches = target_patches.filter(|_| !matches!(patches, Surfels | Faces));
        let settings = (self, resolution, patches, target_patches, rays, seed, skip, only);
        let bytes =
            postcard::to_stdvec(&settings).map_err(|e| Error::Option(format!("settings without a key: {e}")))?;
        Ok(blake3::hash(&bytes))
    }
}
