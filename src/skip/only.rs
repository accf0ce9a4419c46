//! Baking some meshes alone.

use glam::Vec3;
use rayon::prelude::*;

use crate::{
    Error, Result, Scene,
    reconstruct::PatchIndex,
    scene::list,
    simplify::{NO_PATCH, Patches, Simplified, clip::point_at, normal_of},
    transfer::FormFactors,
};

/// The meshes whose light is asked for.
pub struct Wanted {
    meshes: Vec<bool>,
}

/// Patches this many voxels from a wanted surface take part in its light: reconstruction looks for neighbours within
/// 1.5.
const RADIUS: f32 = 1.55;
/// Bounces after which importance is small, and the share of it that may be left.
const BOUNCES: usize = 64;
const REST: f64 = 1e-3;

impl Wanted {
    /// The meshes that `names` names; `None` if there are no names.
    ///
    /// # Errors
    /// [`Error::Option`] for a name that no mesh has, with those that are like it.
    pub fn new(scene: &Scene, names: &[String]) -> Result<Option<Wanted>> {
        if names.is_empty() {
            return Ok(None);
        }
        if let Some(name) = names.iter().find(|name| !scene.meshes.contains(name)) {
            return Err(Error::Option(format!("--only \"{name}\": there is no such mesh; {}", known(scene, name))));
        }
        Ok(Some(Wanted { meshes: scene.meshes.iter().map(|m| names.contains(m)).collect() }))
    }

    /// Whether triangle `t` is of a wanted mesh.
    pub fn has(&self, scene: &Scene, t: usize) -> bool {
        self.meshes[scene.triangles[t].mesh as usize]
    }

    /// Patches that hold wanted surface, and all whose light is carried to it.
    pub fn patches(&self, scene: &Scene, simplified: &Simplified, index: &PatchIndex) -> [Vec<bool>; 2] {
        let (fragments, patches) = (&simplified.fragments, &simplified.patches);
        let sides = |f: usize| [0, 1].map(|side| (fragments.patch[f][side], if side == 1 { -1.0 } else { 1.0 }));
        let wanted: Vec<usize> =
            (0..fragments.len()).filter(|&f| self.has(scene, fragments.triangle[f] as usize)).collect();
        let mut own = vec![false; patches.len()];
        for (patch, _) in wanted.iter().flat_map(|&f| sides(f)).filter(|s| s.0 != NO_PATCH) {
            own[patch as usize] = true;
        }
        let near: Vec<u32> = wanted
            .par_iter()
            .flat_map_iter(|&f| {
                let corners = simplified.corners(fragments.triangle[f] as usize);
                let mut found = Vec::new();
                for (_, sign) in sides(f).into_iter().filter(|s| s.0 != NO_PATCH) {
                    let normal = sign * normal_of(&corners);
                    for &uv in fragments.uv(f) {
                        index.near(point_at(&corners, uv), RADIUS, |j| {
                            // Shading normals may lean by another 30 degrees.
                            if patches.normal[j].dot(normal) >= 0.0 {
                                found.push(j as u32);
                            }
                        });
                    }
                }
                found.sort_unstable();
                found.dedup();
                found
            })
            .collect();
        let mut all = own.clone();
        near.into_iter().for_each(|j| all[j as usize] = true);
        [own, all]
    }
}

/// Names that are like `name`, else all.
fn known(scene: &Scene, name: &str) -> String {
    let mut names: Vec<&String> = scene.meshes.iter().collect();
    names.sort();
    names.dedup();
    let plain = |s: &str| s.to_lowercase().chars().filter(|c| c.is_alphanumeric()).collect::<String>();
    let name = plain(name);
    let like = |m: &&&String| {
        let m = plain(m);
        !m.is_empty() && !name.is_empty() && (m.contains(&name) || name.contains(&m))
    };
    let near: Vec<&String> = names.iter().filter(like).copied().collect();
    let (text, of) = if near.is_empty() { ("there are", names) } else { ("like it are", near) };
    let quoted: Vec<String> = of.iter().map(|m| format!("\"{m}\"")).collect();
    format!("{text} {}", list(&quoted, 30))
}

/// Standard error of the mean irradiance of the patches `own` that the rows of the `few` cause by having fewer rays,
/// relative to that mean.
///
/// Importance of a row: the share of its irradiance in the wanted mean, over all paths, w (1 - F rho)^-1 F. The
/// variance of a row of n random rays is that of the radiosity they meet over n; strata make it smaller.
pub fn noise(
    patches: &Patches,
    f: &FormFactors,
    irradiance: impl Fn(usize) -> Vec3,
    radiosity: &[Vec3],
    own: &[bool],
    few: &[bool],
) -> f64 {
    let n = patches.len();
    let mean = |v: Vec3| v.element_sum() as f64 / 3.0;
    let weight = |i: usize| if own[i] && f.has_row(i) { patches.area[i] as f64 } else { 0.0 };
    let total: f64 = (0..n).map(weight).sum();
    let wanted: f64 = (0..n).map(|i| weight(i) * mean(irradiance(i))).sum();
    if wanted <= 0.0 {
        return 0.0;
    }
    let mut sent: Vec<f64> = (0..n).map(|i| weight(i) / total).collect();
    let mut importance = vec![0.0; n];
    for _ in 0..BOUNCES {
        let mut arrived = vec![0.0; n];
        for i in (0..n).filter(|&i| sent[i] > 0.0) {
            f.row(i).for_each(|(j, share)| arrived[j] += sent[i] * share);
        }
        for j in 0..n {
            sent[j] = arrived[j] * mean(patches.albedo[j]);
            importance[j] += sent[j];
        }
        if sent.iter().sum::<f64>() < REST {
            break;
        }
    }
    let variance = |j: usize| {
        let (mut first, mut second) = (0.0, 0.0);
        for (k, share) in f.row(j) {
            let b = mean(radiosity[k]);
            first += share * b;
            second += share * b * b;
        }
        (second - first * first).max(0.0) / f.rays(j).0.max(1) as f64
    };
    let all = (0..n).filter(|&j| few[j] && importance[j] > 0.0 && f.has_row(j));
    all.map(|j| importance[j].powi(2) * variance(j)).sum::<f64>().sqrt() * total / wanted
}
