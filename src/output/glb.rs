//! `lit.glb`: the baked surfaces as any glTF viewer shows them.

use std::{io, io::Write};

use glam::Vec3;
use serde_json::json;

use super::{
    emission, is_back,
    tonemap::{CURVE, ToneMap},
};
use crate::{Scene, bake::Irradiance, simplify::SplitMesh};

/// Bytes of a vertex: position and normal (12 each), colour (4 x u16).
const STRIDE: usize = 32;
/// No vertex.
const NONE: u32 = u32::MAX;

/// The lit surfaces, one vertex a (split-mesh vertex, material), so that colours do not bleed across material borders.
pub struct LitMesh {
    /// Positions, world units from the frame's origin.
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    /// Outgoing radiance, W/m2/sr: albedo (direct + indirect) / pi + emission.
    radiance: Vec<Vec3>,
    emissive: Vec<bool>,
    triangles: Vec<[u32; 3]>,
}

impl LitMesh {
    /// Joins the split mesh with its light and the scene's materials.
    pub fn new(scene: &Scene, mesh: &SplitMesh, light: &Irradiance) -> LitMesh {
        let mut lit = LitMesh {
            positions: Vec::with_capacity(mesh.positions.len()),
            normals: Vec::with_capacity(mesh.positions.len()),
            radiance: Vec::with_capacity(mesh.positions.len()),
            emissive: Vec::with_capacity(mesh.positions.len()),
            triangles: Vec::with_capacity(mesh.triangles.len()),
        };
        // The last of each vertex that is here, and for each here its look and the one before: a vertex has one look or two.
        let mut last = vec![NONE; mesh.positions.len()];
        let mut looks = Vec::with_capacity(mesh.positions.len());
        for (i, triangle) in mesh.triangles.iter().enumerate() {
            let source = mesh.source[i] as usize;
            let (albedo, emission) = (scene.constant_albedo(source), emission(scene, source, is_back(scene, mesh, i)));
            let emissive = emission != Vec3::ZERO;
            // Lamps have the mean emission of their triangle, which a texture makes each triangle's own.
            let look = (scene.triangles[source].material, emissive.then_some(mesh.source[i]));
            lit.triangles.push(triangle.map(|v| {
                let v = v as usize;
                let mut at = last[v];
                while let Some(&(other, before)) = looks.get(at as usize)
                    && other != look
                {
                    at = before;
                }
                if at == NONE {
                    at = lit.positions.len() as u32;
                    looks.push((look, std::mem::replace(&mut last[v], at)));
                    let irradiance = light.direct[v] + light.indirect[v];
                    let reflected = albedo.unwrap_or(mesh.albedo[v]) * irradiance / std::f32::consts::PI;
                    lit.positions.push(mesh.positions[v] * scene.frame.scale as f32);
                    lit.normals.push(mesh.normals[v]);
                    lit.radiance.push(reflected + emission);
                    lit.emissive.push(emissive);
                }
                at
            }));
        }
        lit
    }

    /// The automatic exposure: see [`ToneMap::automatic`], over all vertices but those of lamps.
    pub fn tone(&self) -> ToneMap {
        let lit = self.radiance.iter().zip(&self.emissive).filter(|(_, lamp)| !**lamp);
        ToneMap::automatic(lit.map(|(radiance, _)| *radiance))
    }

    /// Writes glTF 2.0 binary. COLOR_0 is the linear display value of the radiance, and KHR_materials_unlit has it
    /// shown as it is; `asset.extras` tells exposure and curve. Positions count from the scene's middle, which is the
    /// node's translation: floats stay precise wherever the scene lies. Axes are the scene's own.
    ///
    /// # Errors
    /// Those of `out`; `FileTooLarge` beyond the format's 4 GiB.
    pub fn write(&self, out: &mut dyn Write, scene: &Scene, tone: ToneMap) -> io::Result<()> {
        let (vertex_bytes, index_bytes) = (STRIDE * self.positions.len(), 12 * self.triangles.len());
        let mut text = serde_json::to_vec(&self.describe(scene, tone))?;
        text.resize(text.len().next_multiple_of(4), b' ');
        let data = vertex_bytes + index_bytes;
        let total = u32::try_from(12 + 8 + text.len() + 8 + data).map_err(|_| io::ErrorKind::FileTooLarge)?;

        out.write_all(b"glTF")?;
        write_u32s(out, &[2, total, text.len() as u32])?;
        out.write_all(b"JSON")?;
        out.write_all(&text)?;
        write_u32s(out, &[data as u32])?;
        out.write_all(b"BIN\0")?;
        for ((position, normal), radiance) in self.positions.iter().zip(&self.normals).zip(&self.radiance) {
            for x in [position.to_array(), normal.to_array()].as_flattened() {
                out.write_all(&x.to_le_bytes())?;
            }
            for x in tone.display(*radiance).extend(1.0).to_array() {
                out.write_all(&((65535.0 * x + 0.5) as u16).to_le_bytes())?;
            }
        }
        self.triangles.iter().try_for_each(|t| write_u32s(out, t))
    }

    fn describe(&self, scene: &Scene, tone: ToneMap) -> serde_json::Value {
        let bound = |f: fn(Vec3, Vec3) -> Vec3| {
            let all = self.positions.iter().copied().reduce(f).unwrap_or_default();
            // As f64, or the decimal would be a rounded one and the bounds not those of the data.
            all.to_array().map(f64::from)
        };
        let (vertices, indices) = (self.positions.len(), 3 * self.triangles.len());
        let vertex_bytes = STRIDE * vertices;
        json!({
            "asset": {
                "version": "2.0",
                "generator": concat!("luxel ", env!("CARGO_PKG_VERSION")),
                "extras": {"exposure": tone.exposure, "tone_curve": CURVE, "colour": "COLOR_0 is linear display RGB"},
            },
            "extensionsUsed": ["KHR_materials_unlit"],
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"name": scene.name, "mesh": 0, "translation": scene.frame.origin.to_array()}],
            "meshes": [{"name": scene.name, "primitives": [{
                "attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}, "indices": 3, "material": 0,
            }]}],
            "materials": [{
                "name": "baked light",
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
                "extensions": {"KHR_materials_unlit": {}},
            }],
            "buffers": [{"byteLength": vertex_bytes + 4 * indices}],
            "bufferViews": [
                {"buffer": 0, "byteLength": vertex_bytes, "byteStride": STRIDE, "target": 34962},
                {"buffer": 0, "byteOffset": vertex_bytes, "byteLength": 4 * indices, "target": 34963},
            ],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": vertices, "type": "VEC3",
                 "min": bound(Vec3::min), "max": bound(Vec3::max)},
                {"bufferView": 0, "byteOffset": 12, "componentType": 5126, "count": vertices, "type": "VEC3"},
                {"bufferView": 0, "byteOffset": 24, "componentType": 5123, "normalized": true, "count": vertices,
                 "type": "VEC4"},
                {"bufferView": 1, "componentType": 5125, "count": indices, "type": "SCALAR"},
            ],
        })
    }
}

fn write_u32s(out: &mut dyn Write, values: &[u32]) -> io::Result<()> {
    values.iter().try_for_each(|v| out.write_all(&v.to_le_bytes()))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::scene::{Corners, Frame, Material, Triangle};

    /// Two coplanar triangles that share an edge: the first reflects 0.5, the second 0.25 and emits 3.
    fn scene() -> (Scene, SplitMesh, Irradiance) {
        let material = |albedo, emission| Material {
            albedo: Vec3::splat(albedo),
            emission: Vec3::splat(emission),
            ..Default::default()
        };
        let positions = vec![Vec3::ZERO, Vec3::X, Vec3::ONE.with_z(0.0), Vec3::Y].into_iter().map(|p| p * 0.4);
        let positions: Vec<Vec3> = positions.collect();
        let triangles: Vec<[u32; 3]> = vec![[0, 1, 2], [0, 2, 3]];
        let triangle = |i: usize| Triangle {
            vertices: triangles[i],
            material: i as u32,
            mesh: 0,
            two_sided: false,
            emits_back: false,
        };
        let scene = Scene {
            name: "pair".into(),
            frame: Frame { origin: DVec3::new(1e9, 0.25, -3.0), scale: 2.0 },
            positions: positions.clone(),
            triangles: vec![triangle(0), triangle(1)],
            corners: Corners::default(),
            materials: vec![material(0.5, 0.0), material(0.25, 3.0)],
            textures: vec![],
            meshes: vec!["pair".into()],
            lights: vec![],
            camera: None,
            warnings: vec![],
            sides: vec![],
            dropped: Default::default(),
            proxy: None,
        };
        let mesh = SplitMesh {
            positions,
            normals: vec![Vec3::Z; 4],
            albedo: vec![Vec3::splat(0.4); 4],
            triangles,
            source: vec![0, 1],
            patch: vec![0, 1],
            ..Default::default()
        };
        let pi = std::f32::consts::PI;
        let light = Irradiance { direct: vec![Vec3::splat(pi); 4], indirect: vec![Vec3::X * pi; 4] };
        (scene, mesh, light)
    }

    fn written() -> (gltf::Document, Vec<u8>) {
        let (scene, mesh, light) = scene();
        let lit = LitMesh::new(&scene, &mesh, &light);
        let mut file = Vec::new();
        lit.write(&mut file, &scene, ToneMap { exposure: 0.25 }).unwrap();
        let file = gltf::Gltf::from_slice(&file).expect("the glTF crate finds the file valid");
        (file.document, file.blob.unwrap())
    }

    #[test]
    fn the_file_reads_back_with_its_light_as_colours() {
        let (document, blob) = written();
        let node = document.nodes().next().unwrap();
        assert_eq!(node.transform().decomposed().0, [1e9, 0.25, -3.0]);
        let primitive = node.mesh().unwrap().primitives().next().unwrap();
        assert!(primitive.material().unlit());
        let reader = primitive.reader(|_| Some(&blob));
        let positions: Vec<_> = reader.read_positions().unwrap().collect();
        let colours: Vec<_> = reader.read_colors(0).unwrap().into_rgb_f32().collect();
        let indices: Vec<_> = reader.read_indices().unwrap().into_u32().collect();
        // The shared edge's two vertices appear once a material.
        assert_eq!((positions.len(), indices), (6, vec![0, 1, 2, 3, 4, 5]));
        assert_eq!(positions[2], [0.8, 0.8, 0.0]);
        // Reflected: 0.5 * (2, 1, 1); the lamp: 0.25 * (2, 1, 1) + 3; at exposure 0.25, below the shoulder's 0.8
        // but for the lamp. Stored in 16 bits: half a step of error.
        let close = |a: [f32; 3], b: Vec3| (Vec3::from(a) - b).abs().max_element() < 0.6 / 65535.0;
        assert!(close(colours[0], Vec3::new(0.25, 0.125, 0.125)), "{colours:?}");
        let lamp = ToneMap { exposure: 0.25 }.display(Vec3::new(3.5, 3.25, 3.25));
        assert!(lamp.min_element() > 0.8 && close(colours[3], lamp), "{colours:?}");
    }

    #[test]
    fn the_bounds_are_those_of_the_stored_numbers() {
        let (document, _) = written();
        let positions = document.accessors().next().unwrap();
        let exact = |v: Option<gltf::json::Value>| v.unwrap()[0].as_f64().unwrap();
        assert_eq!(exact(positions.min()), 0.0);
        assert_eq!(exact(positions.max()), (0.4f32 * 2.0) as f64);
    }

    #[test]
    fn automatic_exposure_looks_past_lamps() {
        let (scene, mesh, light) = scene();
        let tone = LitMesh::new(&scene, &mesh, &light).tone();
        // All three unlit vertices have radiance (1, 0.5, 0.5).
        let white = super::super::tonemap::luminance(Vec3::new(1.0, 0.5, 0.5));
        assert!((tone.exposure * white - 1.0).abs() < 1e-6);
    }
}
