//! Materials made safe to compute with: colours in range, textures where there are coordinates, opacity of triangles.

use std::collections::HashMap;

use glam::Vec3;

use super::{Builder, Material, RawMaterial, RawMesh, builder::list, clean::finite, material::ALBEDO_MAX};

/// Largest radiance of any channel, W/m2/sr; the surface of the sun has 2e7. Beyond it, sums might overflow f32.
const EMISSION_MAX: f32 = 1e12;

impl Builder {
    pub(super) fn clean_materials(&mut self) {
        let (mut bright, mut negative, mut emission) = (Vec::new(), Vec::new(), Vec::new());
        let mut used = vec![false; self.materials.len()];
        for mesh in self.meshes.iter().filter(|m| !m.triangles.is_empty()) {
            used[mesh.material as usize] = true;
        }
        for (RawMaterial { surface, opacity }, _) in self.materials.iter_mut().zip(used).filter(|(_, used)| *used) {
            let name = || format!("\"{}\"", surface.name);
            if !surface.albedo.is_finite() || surface.albedo.min_element() < 0.0 {
                negative.push(format!("{} ({})", name(), rgb(surface.albedo)));
                surface.albedo = finite(surface.albedo);
            }
            if surface.albedo.max_element() > ALBEDO_MAX {
                bright.push(format!("{} ({})", name(), rgb(surface.albedo)));
                surface.albedo = surface.albedo.min(Vec3::splat(ALBEDO_MAX));
            }
            let clean = finite(surface.emission).min(Vec3::splat(EMISSION_MAX));
            if clean != surface.emission {
                emission.push(format!("{} ({})", name(), rgb(surface.emission)));
                surface.emission = clean;
            }
            if !opacity.factor.is_finite() {
                opacity.factor = 1.0;
            }
        }
        if !bright.is_empty() {
            self.warn(format!("albedo above {ALBEDO_MAX} is clamped to it, materials {}", list(&bright, 8)));
        }
        if !negative.is_empty() {
            self.warn(format!("albedo that is negative or not finite becomes 0, materials {}", list(&negative, 8)));
        }
        if !emission.is_empty() {
            self.warn(format!(
                "emission that is negative or not finite becomes 0, and at most {EMISSION_MAX:e} W/m2/sr counts, materials {}",
                list(&emission, 8)
            ));
        }
    }

    /// Gives meshes without texture coordinates a copy of their material without textures.
    pub(super) fn split_untextured(&mut self) {
        let mut copies: HashMap<u32, u32> = HashMap::new();
        let mut names = Vec::new();
        for mesh in self.meshes.iter_mut().filter(|m| m.uvs.is_empty() && !m.triangles.is_empty()) {
            let material = &self.materials[mesh.material as usize];
            let Material { albedo_texture, emission_texture, .. } = material.surface;
            if albedo_texture.or(emission_texture).is_none() {
                continue;
            }
            let mut copy = material.clone();
            mesh.material = *copies.entry(mesh.material).or_insert_with(|| {
                names.push(format!("\"{}\" in mesh \"{}\"", copy.surface.name, mesh.name));
                copy.surface.albedo_texture = None;
                copy.surface.emission_texture = None;
                self.materials.push(copy);
                self.materials.len() as u32 - 1
            });
        }
        if !names.is_empty() {
            self.warn(format!("no texture coordinates, factors count alone, materials {}", list(&names, 5)));
        }
    }

    /// Mean opacity of a triangle; glowing surfaces always count as opaque.
    pub(super) fn opacity(&self, mesh: &RawMesh, material: &RawMaterial, t: usize) -> f32 {
        if material.surface.emission != Vec3::ZERO {
            return 1.0;
        }
        match material.opacity.texture {
            Some(map) if !mesh.uvs.is_empty() => {
                let [a, b, c] = mesh.triangles[t].map(|v| mesh.uvs[v as usize]);
                let map = &self.opacity_maps[map as usize];
                let samples = super::triangle_samples();
                samples.iter().map(|&(u, v)| material.opacity.at(map, a * (1.0 - u - v) + b * u + c * v)).sum::<f32>()
                    / samples.len() as f32
            }
            _ => material.opacity.everywhere(),
        }
    }
}

fn rgb(c: Vec3) -> String {
    format!("{:?} {:?} {:?}", c.x, c.y, c.z)
}
