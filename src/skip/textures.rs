//! Textures of one colour are taken as plain colour.

use std::borrow::Cow;

use glam::Vec3;

use crate::{Scene, scene::material::ALBEDO_MAX};

/// The scene with textures of one colour multiplied into the materials that name them; and the materials.
///
/// Means over a texture are then exact; sums of equal samples were so up to rounding, a few 1e-7.
pub fn plain(scene: &Scene) -> (Cow<'_, Scene>, Vec<u32>) {
    let colours: Vec<Option<Vec3>> = scene
        .textures
        .iter()
        .map(|t| t.texels.first().copied().filter(|&first| t.texels.iter().all(|&texel| texel == first)))
        .collect();
    let colour = |texture: Option<u32>| colours[texture? as usize];
    let folds = |m: &crate::scene::Material| (colour(m.albedo_texture).is_some(), colour(m.emission_texture).is_some());
    let found: Vec<u32> =
        (0..scene.materials.len() as u32).filter(|&m| folds(&scene.materials[m as usize]) != (false, false)).collect();
    if found.is_empty() {
        return (Cow::Borrowed(scene), found);
    }
    let mut scene = scene.clone();
    for &m in &found {
        let material = &mut scene.materials[m as usize];
        if let Some(colour) = colour(material.albedo_texture) {
            material.albedo = (material.albedo * colour).min(Vec3::splat(ALBEDO_MAX));
            material.albedo_texture = None;
        }
        if let Some(colour) = colour(material.emission_texture) {
            material.emission *= colour;
            material.emission_texture = None;
        }
    }
    (Cow::Owned(scene), found)
}
