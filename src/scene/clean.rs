//! From raw meshes in world coordinates to a [`Scene`] that is safe to compute with.

use glam::{DVec3, Vec2, Vec3};
use serde::Serialize;

use super::{
    Builder, Corners, Frame, Scene, Triangle,
    builder::list,
    coincident,
    sides::{self, SidesRule},
};
use crate::{Error, Result};

/// Coordinates beyond this are refused like infinite ones: their squares and cubes must stay finite in f64.
const FARTHEST: f64 = 1e60;

/// A triangle is dropped if its height over its longest edge is below this, in local units (the longest side of the
/// scene is between 0.5 and 1): 2 ulp of the largest coordinate, so that its normal would be rounding noise.
const THINNEST: f64 = f32::EPSILON as f64;

/// Surfaces of lower opacity neither block nor receive light.
const OPAQUE: f32 = 0.5;

/// What did not enter the scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Dropped {
    /// Faces with fewer than three corners.
    pub short_faces: usize,
    /// Triangles with a corner that is not finite.
    pub not_finite: usize,
    /// Triangles without an area.
    pub zero_area: usize,
    /// Triangles that lie exactly on an earlier one.
    pub duplicate: usize,
    /// Transparent triangles, by material.
    pub transparent: Vec<(String, usize)>,
}

impl Dropped {
    /// Faces and triangles of all kinds.
    pub fn total(&self) -> usize {
        let transparent: usize = self.transparent.iter().map(|t| t.1).sum();
        self.short_faces + self.not_finite + self.zero_area + self.duplicate + transparent
    }
}

impl Builder {
    /// Cleans everything and decides on the sides of all surfaces.
    ///
    /// # Errors
    /// [`Error::Scene`] if no triangle is left, or if there are more than 2^31 - 1; [`Error::Option`] if a mesh does
    /// not fit together: indices beyond its arrays, attribute arrays of another length.
    pub fn build(mut self, rule: SidesRule) -> Result<Scene> {
        self.check_indices()?;
        let total: usize = self.meshes.iter().map(|m| m.triangles.len()).sum();
        let mut dropped = Dropped { short_faces: self.short_faces, ..Dropped::default() };
        self.clean_materials();
        self.split_untextured();
        self.colour_clear_texels();
        let kept = self.opaque_and_finite(&mut dropped);
        let Some(frame) = self.frame(&kept) else {
            dropped.zero_area = kept.len();
            return Err(self.no_geometry(total, &dropped));
        };
        let mut scene = self.assemble(kept, frame, &mut dropped);
        if scene.triangles.is_empty() {
            return Err(self.no_geometry(total, &dropped));
        }
        scene.lights = self.lights.iter().map(|l| l.to_local(&frame)).collect();
        if let Some(light) = scene.lights.iter().position(|l| !l.is_finite()) {
            return Err(Error::Scene(format!(
                "light {} of scene \"{}\" is too strong or too far for a scene of size {:e}",
                light + 1,
                self.name,
                frame.scale
            )));
        }
        scene.warnings = std::mem::take(&mut self.warnings);
        scene.dropped = dropped;
        sides::decide(&mut scene, rule);
        Ok(scene)
    }

    fn check_indices(&self) -> Result<()> {
        let total: usize = self.meshes.iter().map(|m| m.triangles.len()).sum();
        if total >= 1 << 31 {
            return Err(Error::Scene(format!("{total} triangles; at most 2^31 - 1 are possible: split the scene")));
        }
        for mesh in &self.meshes {
            let n = mesh.positions.len();
            let fits = |len: usize| len == 0 || len == n;
            let wrong = |what: &str| Error::Option(format!("mesh \"{}\": {what}", mesh.name));
            if !(fits(mesh.normals.len()) && fits(mesh.uvs.len()) && fits(mesh.colours.len())) {
                return Err(wrong("normals, uvs and colours must be empty or one a vertex"));
            }
            if mesh.triangles.iter().flatten().any(|&v| v as usize >= n) {
                return Err(wrong("a triangle names a vertex that is not there"));
            }
            let Some(material) = self.materials.get(mesh.material as usize) else {
                return Err(wrong("its material is not there; add_material returns the index"));
            };
            if !(mesh.places.is_empty() || mesh.places.len() == mesh.triangles.len()) {
                return Err(wrong("places must be empty or one a triangle"));
            }
            let missing = |i: Option<u32>, len: usize| i.is_some_and(|i| i as usize >= len);
            if missing(material.surface.albedo_texture, self.textures.len())
                || missing(material.surface.emission_texture, self.textures.len())
                || missing(material.opacity.texture, self.opacity_maps.len())
            {
                return Err(wrong("a texture of its material is not there; add_texture returns the index"));
            }
        }
        Ok(())
    }

    fn no_geometry(&self, total: usize, dropped: &Dropped) -> Error {
        let transparent: usize = dropped.transparent.iter().map(|t| t.1).sum();
        let mut why = vec![format!("{total} triangles read")];
        let mut add = |n: usize, what: &str| {
            if n > 0 {
                why.push(format!("{n} {what}"));
            }
        };
        add(dropped.short_faces, "faces with fewer than 3 corners");
        add(dropped.not_finite, "not finite");
        add(dropped.zero_area, "without area");
        add(transparent, "transparent");
        Error::Scene(format!(
            "scene \"{}\" has no geometry: no opaque triangle with an area ({})",
            self.name,
            why.join(", ")
        ))
    }

    /// (mesh, triangle) of everything that is opaque and finite.
    fn opaque_and_finite(&mut self, dropped: &mut Dropped) -> Vec<(u32, u32)> {
        let mut kept = Vec::with_capacity(self.meshes.iter().map(|m| m.triangles.len()).sum());
        let mut transparent = vec![0_usize; self.materials.len()];
        let mut examples = Vec::new();
        for (m, mesh) in self.meshes.iter().enumerate() {
            let material = &self.materials[mesh.material as usize];
            let usable: Vec<bool> = mesh.positions.iter().map(|p| p.abs().max_element() < FARTHEST).collect();
            for (t, corners) in mesh.triangles.iter().enumerate() {
                if self.opacity(mesh, material, t) < OPAQUE {
                    transparent[mesh.material as usize] += 1;
                } else if corners.iter().all(|&v| usable[v as usize]) {
                    kept.push((m as u32, t as u32));
                } else {
                    dropped.not_finite += 1;
                    if examples.len() < 3 {
                        examples.push(mesh.describe(t));
                    }
                }
            }
        }
        for (material, &n) in self.materials.iter().zip(&transparent).filter(|(_, n)| **n > 0) {
            dropped.transparent.push((material.surface.name.clone(), n));
        }
        if dropped.not_finite > 0 {
            self.warn(format!(
                "{} triangles with a corner that is not finite (or beyond {FARTHEST:e}) were dropped: {}",
                dropped.not_finite,
                list(&examples, 3)
            ));
        }
        if !dropped.transparent.is_empty() {
            let names: Vec<String> =
                dropped.transparent.iter().map(|(name, n)| format!("\"{name}\" ({n} triangles)")).collect();
            self.warn(format!(
                "surfaces of opacity below {OPAQUE} neither block nor receive light, materials {}",
                list(&names, 8)
            ));
        }
        kept
    }

    /// The frame that the triangles with an area fit in; `None` if there are none.
    fn frame(&self, kept: &[(u32, u32)]) -> Option<Frame> {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &(m, t) in kept {
            let corners = self.meshes[m as usize].corners(t as usize);
            // Thinner ones will be dropped in any frame that they fit in; they shall not blow it up.
            if height(corners) > 0.5 * THINNEST * longest(corners) {
                for p in corners {
                    low = low.min(p);
                    high = high.max(p);
                }
            }
        }
        let extent = (high - low).max_element();
        // exp2 of a whole number is exact, so that scaling adds no rounding.
        (extent > 0.0).then(|| Frame { origin: 0.5 * (low + high), scale: extent.log2().ceil().exp2() })
    }

    fn assemble(&mut self, kept: Vec<(u32, u32)>, frame: Frame, dropped: &mut Dropped) -> Scene {
        let mut mesh_names: Vec<String> = Vec::new();
        let mesh_of: Vec<u32> = (self.meshes.iter())
            .map(|mesh| {
                if mesh_names.last() != Some(&mesh.name) {
                    mesh_names.push(mesh.name.clone());
                }
                mesh_names.len() as u32 - 1
            })
            .collect();
        // Local vertices of every mesh, shared by its triangles; unused ones are not made.
        let mut positions: Vec<Vec3> = Vec::new();
        let mut triangles = Vec::with_capacity(kept.len());
        let mut sources = Vec::with_capacity(kept.len());
        let (mut current, mut local) = (u32::MAX, Vec::new());
        let mut examples = Vec::new();
        for (m, t) in kept {
            let mesh = &self.meshes[m as usize];
            if m != current {
                current = m;
                local.clear();
                local.resize(mesh.positions.len(), u32::MAX);
            }
            let corners = mesh.corners(t as usize).map(|p| frame.to_local(p));
            // A triangle without area may lie outside the frame, even beyond f32.
            let height = height(corners.map(Vec3::as_dvec3));
            if height.is_nan() || height <= THINNEST {
                dropped.zero_area += 1;
                if examples.len() < 3 {
                    examples.push(mesh.describe(t as usize));
                }
                continue;
            }
            let mut vertices = [0; 3];
            for k in 0..3 {
                let slot = &mut local[mesh.triangles[t as usize][k] as usize];
                if *slot == u32::MAX {
                    *slot = positions.len() as u32;
                    positions.push(corners[k]);
                }
                vertices[k] = *slot;
            }
            triangles.push(Triangle {
                vertices,
                material: mesh.material,
                mesh: mesh_of[m as usize],
                two_sided: true,
                emits_back: false,
            });
            sources.push((m, t));
        }
        if dropped.zero_area > 0 {
            self.warn(format!("{} triangles without area were dropped: {}", dropped.zero_area, list(&examples, 3)));
        }
        self.drop_duplicates(&positions, &mut triangles, &mut sources, dropped);
        let corners = self.corners(&positions, &triangles, &sources);
        Scene {
            name: self.name.clone(),
            frame,
            positions,
            triangles,
            corners,
            materials: self.materials.iter().map(|m| m.surface.clone()).collect(),
            textures: std::mem::take(&mut self.textures),
            meshes: mesh_names,
            lights: Vec::new(),
            camera: self.camera,
            warnings: Vec::new(),
            sides: Vec::new(),
            dropped: Dropped::default(),
            proxy: None,
        }
    }

    fn drop_duplicates(
        &mut self,
        positions: &[Vec3],
        triangles: &mut Vec<Triangle>,
        sources: &mut Vec<(u32, u32)>,
        dropped: &mut Dropped,
    ) {
        let emits = |t: &Triangle| self.materials[t.material as usize].surface.emission != Vec3::ZERO;
        let (drop, opposite) = coincident::find(positions, triangles, emits);
        dropped.duplicate = drop.iter().filter(|d| **d).count();
        if dropped.duplicate == 0 {
            return;
        }
        let examples: Vec<String> = (0..drop.len())
            .filter(|&t| drop[t])
            .take(3)
            .map(|t| self.meshes[sources[t].0 as usize].describe(sources[t].1 as usize))
            .collect();
        self.warn(format!(
            "{} triangles coincide with others and were dropped ({opposite} of them face the other way): {}",
            dropped.duplicate,
            list(&examples, 3)
        ));
        let mut keep = drop.iter().map(|d| !d);
        triangles.retain(|_| keep.next().unwrap_or(true));
        let mut keep = drop.iter().map(|d| !d);
        sources.retain(|_| keep.next().unwrap_or(true));
    }

    fn corners(&self, positions: &[Vec3], triangles: &[Triangle], sources: &[(u32, u32)]) -> Corners {
        let mesh = |s: &(u32, u32)| &self.meshes[s.0 as usize];
        let textured = |m: u32| {
            let surface = &self.materials[m as usize].surface;
            surface.albedo_texture.is_some() || surface.emission_texture.is_some()
        };
        let mut corners = Corners::default();
        if sources.iter().any(|s| !mesh(s).normals.is_empty()) {
            corners.normals = (triangles.iter().zip(sources))
                .map(|(triangle, s)| {
                    let [a, b, c] = triangle.vertices.map(|v| positions[v as usize].as_dvec3());
                    let flat = (b - a).cross(c - a).normalize().as_vec3();
                    let given = mesh(s).at_corners(&mesh(s).normals, s.1).unwrap_or([flat; 3]);
                    shading_normals(flat, given)
                })
                .collect();
        }
        if triangles.iter().any(|t| textured(t.material)) {
            corners.uvs =
                sources.iter().map(|s| mesh(s).at_corners(&mesh(s).uvs, s.1).unwrap_or([Vec2::ZERO; 3])).collect();
        }
        if sources.iter().any(|s| !mesh(s).colours.is_empty()) {
            corners.colours = (sources.iter())
                .map(|s| mesh(s).at_corners(&mesh(s).colours, s.1).unwrap_or([Vec3::ONE; 3]).map(finite))
                .collect();
        }
        corners
    }
}

/// Unit normals on the side of the triangle's own; the latter where a corner's normal is unusable.
///
/// A file whose normals disagree with its winding as a whole means the same surface: they are turned around.
fn shading_normals(flat: Vec3, given: [Vec3; 3]) -> [Vec3; 3] {
    let unit = given.map(|n| n.as_dvec3().try_normalize().map_or(flat, glam::DVec3::as_vec3));
    let sign = if unit.iter().map(|n| n.dot(flat)).sum::<f32>() < 0.0 { -1.0 } else { 1.0 };
    unit.map(|n| if (sign * n).dot(flat) > 0.0 { sign * n } else { flat })
}

/// Twice the area over the longest edge; 0 for a point.
fn height([a, b, c]: [DVec3; 3]) -> f64 {
    let longest = longest([a, b, c]);
    if longest == 0.0 { 0.0 } else { ((b - a) / longest).cross((c - a) / longest).length() * longest }
}

/// The longest edge.
fn longest([a, b, c]: [DVec3; 3]) -> f64 {
    (b - a).length().max((c - b).length()).max((a - c).length())
}

/// Components that are negative or not finite become 0.
pub(super) fn finite(v: Vec3) -> Vec3 {
    Vec3::from_array(v.to_array().map(|x| if x.is_finite() && x > 0.0 { x } else { 0.0 }))
}
