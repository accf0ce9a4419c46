//! glTF 2.0 and GLB files.
//!
//! The `gltf` crate parses and validates the JSON; bytes are read by [`super::gltf_data`], because `gltf::import` follows
//! any path. Photometric numbers of KHR_lights_punctual are taken as they are: candela as W/sr, lux as W/m2.
//! Morph targets and skins are ignored: meshes stand as they were modelled, moved by their node.

use std::path::Path;

use glam::{DAffine3, DMat4, DQuat, DVec3, Vec2, Vec3};
use gltf::{Document, Node, Primitive, Semantic, json, mesh::Mode, scene::Transform};
use json::validation::Validate;

use super::{
    Camera, WorldLight,
    builder::Builder,
    gltf_data::Buffers,
    gltf_material::{self, Entry},
    path,
    raw::RawMesh,
};
use crate::{Error, Result};

/// Triangles of all instances together; more would not fit in memory.
const MOST_TRIANGLES: usize = 1 << 27;

/// Required extensions that change what is read here and are supported, or change nothing that matters to diffuse light.
fn is_supported(extension: &str) -> bool {
    matches!(extension, "KHR_lights_punctual" | "KHR_texture_transform" | "KHR_mesh_quantization")
        || (extension.starts_with("KHR_materials_")
            && !matches!(extension, "KHR_materials_pbrSpecularGlossiness" | "KHR_materials_variants"))
}

/// Reads a glTF or GLB file into `builder`.
///
/// # Errors
/// [`Error::Io`], or [`Error::Input`] with the JSON path or the accessor, buffer, node or mesh that is wrong. Missing
/// textures become warnings.
pub(crate) fn read(file: &Path, builder: &mut Builder) -> Result<()> {
    let bytes = std::fs::read(file).map_err(|e| Error::io(file, e))?;
    let wrong = |message: String| Error::input(file, "", message);
    let (document, blob) = parse(file, &bytes).map_err(wrong)?;
    let buffers = Buffers::load(&document, blob.as_deref(), path::folder(file)).map_err(wrong)?;
    let materials = gltf_material::read(&document, &buffers, path::folder(file), builder);
    let mut reader =
        Reader { document: &document, buffers, materials, builder, triangles: 0, not_triangles: 0, plain: 0 };
    reader.nodes().map_err(wrong)?;
    let Reader { not_triangles, plain, .. } = reader;
    if plain > 0 {
        builder.warn(format!(
            "{}: {plain} primitives without a material are grey, albedo {}",
            file.display(),
            super::mtl::DEFAULT_ALBEDO.x
        ));
    }
    if not_triangles > 0 {
        builder.warn(format!("{}: {not_triangles} primitives of points or lines were left out", file.display()));
    }
    Ok(())
}

/// A document that the `gltf` crate can walk without panicking, and the binary chunk.
fn parse(file: &Path, bytes: &[u8]) -> std::result::Result<(Document, Option<Vec<u8>>), String> {
    let glb = file.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb"));
    if bytes.starts_with(b"glTF") {
        // The crate subtracts the header's size from this length without a check.
        let length = bytes.get(8..12).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])) as usize;
        if length < 20 || length > bytes.len() {
            return Err(format!("the file is truncated: it has {} bytes, its header says {length}", bytes.len()));
        }
    } else if glb {
        return Err("this is not a GLB file: it does not begin with \"glTF\"".into());
    }
    let gltf = gltf::Gltf::from_slice_without_validation(bytes).map_err(|e| match e {
        gltf::Error::Binary(e) => format!("the GLB container is broken or truncated: {e}"),
        gltf::Error::Deserialize(e) => format!("not the JSON of glTF: {e}"),
        e => e.to_string(),
    })?;
    let root = gltf.document.into_json();
    if let Some(extension) = root.extensions_required.iter().find(|e| !is_supported(e)) {
        return Err(format!("unsupported required extension {extension}; export the file without it"));
    }
    // gltf-json's own validation indexes with these before it checks them.
    for (m, mesh) in root.meshes.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            if let Some(bad) = primitive.attributes.values().find(|i| i.value() >= root.accessors.len()) {
                return Err(format!("mesh {m}, primitive {p}: accessor {} does not exist", bad.value()));
            }
        }
    }
    let mut problem = None;
    root.validate(&root, json::Path::new, &mut |path, error| {
        let path = path().to_string();
        // Bounds of positions are not used here, and the extensions were looked at above.
        let harmless = path.ends_with(".min") || path.ends_with(".max") || path.starts_with("extensionsRequired");
        if problem.is_none() && !harmless {
            problem = Some(format!("{path}: {error}"));
        }
    });
    match problem {
        Some(problem) => Err(format!("invalid glTF: {problem}")),
        None => Ok((Document::from_json_without_validation(root), gltf.blob)),
    }
}

struct Reader<'a> {
    document: &'a Document,
    buffers: Buffers<'a>,
    /// The last one is for primitives without a material.
    materials: Vec<Entry>,
    builder: &'a mut Builder,
    triangles: usize,
    not_triangles: usize,
    plain: usize,
}

impl Reader<'_> {
    /// Walks the nodes of the default scene, else of the first one, else all; without recursion, as graphs may be deep.
    fn nodes(&mut self) -> std::result::Result<(), String> {
        let document = self.document;
        let mut is_child = vec![false; document.nodes().len()];
        for child in document.nodes().flat_map(|n| n.children()) {
            is_child[child.index()] = true;
        }
        let roots: Vec<Node> = match document.default_scene().or_else(|| document.scenes().next()) {
            Some(scene) => scene.nodes().collect(),
            None => document.nodes().filter(|n| !is_child[n.index()]).collect(),
        };
        let mut reached = vec![false; document.nodes().len()];
        let mut stack: Vec<(Node, DAffine3)> = roots.into_iter().rev().map(|n| (n, DAffine3::IDENTITY)).collect();
        while let Some((node, parent)) = stack.pop() {
            if std::mem::replace(&mut reached[node.index()], true) {
                return Err(format!(
                    "node {} is its own ancestor or has two parents; nodes must form trees",
                    node.index()
                ));
            }
            let transform = parent * local_transform(&node);
            self.node(&node, &transform)?;
            let children: Vec<Node> = node.children().collect();
            stack.extend(children.into_iter().rev().map(|child| (child, transform)));
        }
        Ok(())
    }

    fn node(&mut self, node: &Node, transform: &DAffine3) -> std::result::Result<(), String> {
        let mark = self.builder.mark();
        if let Some(mesh) = node.mesh() {
            let name = node.name().or(mesh.name()).map_or_else(|| format!("node {}", node.index()), str::to_string);
            for (p, primitive) in mesh.primitives().enumerate() {
                self.primitive(&primitive, &name)
                    .map_err(|e| format!("mesh {} \"{name}\", primitive {p}: {e}", mesh.index()))?;
            }
        }
        let json = &self.document.as_json().nodes[node.index()];
        if let Some(light) = json.extensions.as_ref().and_then(|e| e.khr_lights_punctual.as_ref()) {
            self.light(light.light.value())?;
        }
        self.builder.transform_since(mark, transform);
        if let Some(camera) = json.camera.and_then(|c| self.document.as_json().cameras.get(c.value())) {
            self.camera(camera, transform);
        }
        Ok(())
    }

    fn primitive(&mut self, primitive: &Primitive, name: &str) -> std::result::Result<(), String> {
        if !matches!(primitive.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
            self.not_triangles += 1;
            return Ok(());
        }
        let positions = primitive.get(&Semantic::Positions).ok_or("it has no POSITION")?;
        let (material, uv) = self.materials[primitive.material().index().unwrap_or(self.materials.len() - 1)];
        self.plain += usize::from(primitive.material().index().is_none());
        let uvs = uv.and_then(|u| primitive.get(&Semantic::TexCoords(u.set)));
        let indices = primitive.indices().map(|a| self.buffers.indices(&a)).transpose()?;
        let vertices = positions.count();
        self.triangles +=
            indices.as_ref().map_or(vertices, Vec::len) / if primitive.mode() == Mode::Triangles { 3 } else { 1 };
        if self.triangles > MOST_TRIANGLES {
            return Err(format!("the scene has more than {MOST_TRIANGLES} triangles"));
        }
        if let Some(bad) = indices.iter().flatten().find(|i| **i as usize >= vertices) {
            return Err(format!("index {bad} does not exist, there are {vertices} vertices"));
        }
        let positions = self.buffers.read::<3>(&positions)?;
        let normals = primitive.get(&Semantic::Normals).map(|a| self.buffers.read::<3>(&a)).transpose()?;
        let colours = primitive.get(&Semantic::Colors(0)).map(|a| self.buffers.read::<3>(&a)).transpose()?;
        let uvs = uvs.map(|a| self.buffers.read::<2>(&a)).transpose()?;
        let order = indices.unwrap_or_else(|| (0..vertices as u32).collect());
        let vec3 =
            |list: Option<Vec<[f32; 3]>>| list.unwrap_or_default().into_iter().map(Vec3::from).collect::<Vec<_>>();
        let mesh = RawMesh {
            name: name.to_string(),
            positions: positions.iter().map(|p| Vec3::from(*p).as_dvec3()).collect(),
            normals: vec3(normals),
            uvs: uv
                .map_or(Vec::new(), |u| uvs.unwrap_or_default().into_iter().map(|v| u.apply(Vec2::from(v))).collect()),
            colours: vec3(colours),
            triangles: triangles(primitive.mode(), &order),
            place: "".into(),
            places: Vec::new(),
            material,
        };
        for (what, n) in [("NORMAL", mesh.normals.len()), ("TEXCOORD", mesh.uvs.len()), ("COLOR_0", mesh.colours.len())]
        {
            if n != 0 && n != mesh.positions.len() {
                return Err(format!("{what} has {n} elements, POSITION has {}", mesh.positions.len()));
            }
        }
        self.builder.add_mesh(mesh);
        Ok(())
    }

    /// Adds a light at the origin, pointing to -z as glTF's lights do.
    fn light(&mut self, index: usize) -> std::result::Result<(), String> {
        use json::extensions::scene::khr_lights_punctual::Type;
        let root = self.document.as_json();
        let lights = root.extensions.as_ref().and_then(|e| e.khr_lights_punctual.as_ref());
        let light = lights.and_then(|l| l.lights.get(index)).ok_or_else(|| format!("light {index} does not exist"))?;
        let strength = Vec3::from(light.color) * light.intensity;
        let range = light.range.map_or(f64::INFINITY, f64::from);
        let world = match (&light.type_, &light.spot) {
            (json::validation::Checked::Valid(Type::Directional), _) => {
                WorldLight::Sun { direction: DVec3::NEG_Z, irradiance: strength }
            }
            (json::validation::Checked::Valid(Type::Point), _) => {
                WorldLight::Point { position: DVec3::ZERO, intensity: strength, range }
            }
            (json::validation::Checked::Valid(Type::Spot), Some(spot)) => WorldLight::Spot {
                position: DVec3::ZERO,
                direction: DVec3::NEG_Z,
                intensity: strength,
                inner: f64::from(spot.inner_cone_angle).to_degrees(),
                outer: f64::from(spot.outer_cone_angle).to_degrees().min(90.0),
                range,
            },
            _ => return Err(format!("light {index} has no type, or is a spot without angles")),
        };
        if let Some(problem) = world.problem() {
            return Err(format!("light {index}: {problem}"));
        }
        self.builder.add_light(world);
        Ok(())
    }

    /// The first perspective camera is the preview's.
    fn camera(&mut self, camera: &json::Camera, transform: &DAffine3) {
        let Some(perspective) = &camera.perspective else { return };
        let position = transform.translation;
        let forward = transform.transform_vector3(DVec3::NEG_Z).normalize_or(DVec3::NEG_Z);
        let up = transform.transform_vector3(DVec3::Y).normalize_or(DVec3::Y);
        let vertical_fov = f64::from(perspective.yfov).to_degrees();
        if position.is_finite() && vertical_fov > 0.0 && vertical_fov < 180.0 {
            self.builder.suggest_camera(Camera { position, target: position + forward, up, vertical_fov });
        }
    }
}

fn local_transform(node: &Node) -> DAffine3 {
    match node.transform() {
        Transform::Matrix { matrix } => {
            DAffine3::from_mat4(DMat4::from_cols_array_2d(&matrix.map(|column| column.map(f64::from))))
        }
        Transform::Decomposed { translation, rotation, scale } => {
            let [x, y, z, w] = rotation.map(f64::from);
            let rotation = DQuat::from_xyzw(x, y, z, w);
            let rotation = if rotation.length() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY };
            DAffine3::from_scale_rotation_translation(
                DVec3::from_array(scale.map(f64::from)),
                rotation,
                DVec3::from_array(translation.map(f64::from)),
            )
        }
    }
}

/// Triangles of a primitive, wound as glTF 2.0 section 3.7.2.1 says.
fn triangles(mode: Mode, order: &[u32]) -> Vec<[u32; 3]> {
    let n = order.len().saturating_sub(2);
    match mode {
        Mode::TriangleStrip => (0..n).map(|i| [order[i], order[i + 1 + i % 2], order[i + 2 - i % 2]]).collect(),
        Mode::TriangleFan => (0..n).map(|i| [order[i + 1], order[i + 2], order[0]]).collect(),
        _ => order.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_and_fans_keep_their_winding() {
        assert_eq!(triangles(Mode::TriangleStrip, &[0, 1, 2, 3]), [[0, 1, 2], [1, 3, 2]]);
        assert_eq!(triangles(Mode::TriangleFan, &[0, 1, 2, 3]), [[1, 2, 0], [2, 3, 0]]);
        assert!(triangles(Mode::TriangleFan, &[0]).is_empty());
    }
}
