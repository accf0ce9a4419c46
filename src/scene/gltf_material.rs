//! Materials of glTF.
//!
//! Rules:
//! - The albedo is baseColorFactor x baseColorTexture x COLOR_0, whatever metallicFactor says: metals count as diffuse.
//!   Factors and COLOR_0 are linear, textures are sRGB, as glTF says.
//! - The emission is emissiveFactor x emissiveTexture x KHR_materials_emissive_strength, as radiance, W/m2/sr.
//! - KHR_materials_unlit is a finished look and no lamp: its emission is left out, with a warning.
//! - Opacity is baseColorFactor's and the texture's alpha (alphaMode MASK and BLEND), times 1 - transmissionFactor.

use std::{collections::HashMap, path::Path};

use glam::{Vec2, Vec3};
use gltf::{Document, material::AlphaMode, texture::Info};

use super::{
    Material,
    builder::{Builder, list},
    gltf_data::Buffers,
    mtl::DEFAULT_ALBEDO,
    raw::{Opacity, RawMaterial},
};

/// Which texture coordinates a material reads, and how they are moved first (KHR_texture_transform).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UvSource {
    pub set: u32,
    offset: Vec2,
    rotation: f32,
    scale: Vec2,
}

impl UvSource {
    /// Texture coordinates as the texture is read.
    pub(crate) fn apply(&self, uv: Vec2) -> Vec2 {
        let (sin, cos) = self.rotation.sin_cos();
        let uv = uv * self.scale;
        self.offset + Vec2::new(cos * uv.x + sin * uv.y, -sin * uv.x + cos * uv.y)
    }

    fn of(info: &Info) -> UvSource {
        let transform = info.texture_transform();
        let (offset, rotation, scale) =
            transform.as_ref().map_or(([0.0; 2], 0.0, [1.0; 2]), |t| (t.offset(), t.rotation(), t.scale()));
        let set = transform.as_ref().and_then(|t| t.tex_coord()).unwrap_or(info.tex_coord());
        UvSource { set, offset: offset.into(), rotation, scale: scale.into() }
    }
}

/// Index of a material and where its texture coordinates come from.
pub(crate) type Entry = (u32, Option<UvSource>);

/// Adds all materials of `document`, and behind them one for surfaces without a material. glTF calls it white; here it is
/// grey as for OBJ, because a white room is one that no light leaves.
pub(crate) fn read(document: &Document, buffers: &Buffers, folder: &Path, builder: &mut Builder) -> Vec<Entry> {
    let mut textures = Textures { document, buffers, folder, known: HashMap::new(), missing: Vec::new() };
    let (mut unlit, mut other_uv) = (Vec::new(), Vec::new());
    let mut entries: Vec<Entry> = Vec::new();
    for (i, m) in document.materials().enumerate() {
        let name = m.name().map_or_else(|| format!("material {i}"), str::to_string);
        let pbr = m.pbr_metallic_roughness();
        let base = pbr.base_color_texture();
        let [r, g, b, alpha] = pbr.base_color_factor();
        let base_image = base.as_ref().and_then(|t| textures.load(t, builder));
        let mut emission = Vec3::from(m.emissive_factor()) * m.emissive_strength().unwrap_or(1.0);
        let glow = m.emissive_texture().filter(|_| emission != Vec3::ZERO);
        if m.unlit() && emission != Vec3::ZERO {
            unlit.push(format!("\"{name}\""));
            emission = Vec3::ZERO;
        }
        let glow_image = glow.as_ref().filter(|_| !m.unlit()).and_then(|t| textures.load(t, builder));
        let uv = base.as_ref().filter(|_| base_image.is_some()).map(UvSource::of);
        let glow_uv = glow.as_ref().filter(|_| glow_image.is_some()).map(UvSource::of);
        if uv.is_some() && glow_uv.is_some() && uv != glow_uv {
            other_uv.push(format!("\"{name}\""));
        }
        let (factor, texture, cutoff) = match m.alpha_mode() {
            AlphaMode::Opaque => (1.0, None, None),
            AlphaMode::Mask => (alpha, base_image.and_then(|i| i.1), Some(m.alpha_cutoff().unwrap_or(0.5))),
            AlphaMode::Blend => (alpha, base_image.and_then(|i| i.1), None),
        };
        let transmission = m.transmission().map_or(0.0, |t| t.transmission_factor());
        let index = builder.add_material(RawMaterial {
            surface: Material {
                name,
                albedo: Vec3::new(r, g, b),
                emission,
                albedo_texture: base_image.map(|i| i.0),
                emission_texture: glow_image.map(|i| i.0),
                double_sided: m.double_sided(),
            },
            opacity: Opacity { factor: factor * (1.0 - transmission), texture, cutoff },
        });
        entries.push((index, uv.or(glow_uv)));
    }
    let surface = Material { name: "default".into(), albedo: DEFAULT_ALBEDO, ..Material::default() };
    entries.push((builder.add_material(RawMaterial { surface, ..RawMaterial::default() }), None));
    if !unlit.is_empty() {
        builder.warn(format!(
            "the emission of KHR_materials_unlit is a finished look and no lamp, it is left out (--emit sets one): {}",
            list(&unlit, 8)
        ));
    }
    if !other_uv.is_empty() {
        builder.warn(format!(
            "base colour and emission have different texture coordinates, the former's serve both: {}",
            list(&other_uv, 8)
        ));
    }
    if !textures.missing.is_empty() {
        builder.warn(format!("textures were not read, their factors count alone: {}", list(&textures.missing, 5)));
    }
    entries
}

/// Colour texture and opacity map of an image.
type Loaded = (u32, Option<u32>);

struct Textures<'a> {
    document: &'a Document,
    buffers: &'a Buffers<'a>,
    folder: &'a Path,
    known: HashMap<usize, Option<Loaded>>,
    missing: Vec<String>,
}

impl Textures<'_> {
    fn load(&mut self, info: &Info, builder: &mut Builder) -> Option<Loaded> {
        let image = self.document.as_json().textures[info.texture().index()].source.value();
        if let Some(known) = self.known.get(&image) {
            return *known;
        }
        let loaded = match self.buffers.image(self.document, image, self.folder) {
            Ok(image) => Some((builder.add_texture(image.texture), image.alpha.map(|a| builder.add_opacity_map(a)))),
            Err(cause) => {
                self.missing.push(cause);
                None
            }
        };
        self.known.insert(image, loaded);
        loaded
    }
}
