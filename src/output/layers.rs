//! `preview.exr`: the preview's layers as measured, with the certificate of the bake.

use glam::Vec3;

use super::{
    exr::{ExrAttribute, ExrChannel, ExrImage},
    preview::Preview,
};
use crate::report::Report;

/// The layers of `preview`, channels named `layer.R` as OpenEXR and Blender do: `direct`, `secondary`, `combined`
/// (radiance), `exitance` (of the patches, W/m2), `albedo`, `normal.X/Y/Z` and `depth.Z`; besides them plain `R G B`,
/// the combined radiance again, for viewers without layers.
pub fn image(preview: &Preview, report: &Report) -> ExrImage {
    let rgb = [
        ("", &preview.combined),
        ("direct.", &preview.direct),
        ("exitance.", &preview.exitance),
        ("secondary.", &preview.secondary),
        ("combined.", &preview.combined),
        ("albedo.", &preview.albedo),
    ];
    let mut channels: Vec<ExrChannel> =
        rgb.into_iter().flat_map(|(layer, v)| split(layer, ["R", "G", "B"], v)).collect();
    channels.extend(split("normal.", ["X", "Y", "Z"], &preview.normal));
    channels.push(ExrChannel { name: "depth.Z".into(), half: false, values: preview.depth.clone() });
    ExrImage { width: preview.width, height: preview.height, channels, attributes: certificate(report) }
}

fn split(layer: &str, names: [&str; 3], values: &[Vec3]) -> Vec<ExrChannel> {
    let channel = |(axis, name): (usize, &&str)| ExrChannel {
        name: format!("{layer}{name}"),
        half: false,
        values: values.iter().map(|v| v[axis]).collect(),
    };
    names.iter().enumerate().map(channel).collect()
}

/// What made the picture and how sure it is, as attributes `luxel.*`.
fn certificate(report: &Report) -> Vec<(String, ExrAttribute)> {
    let mut texts = vec![
        ("version", report.version.clone()),
        ("backend", report.backend.clone()),
        ("instructionSet", report.instruction_set.clone()),
        ("solver", report.solver.method.to_string()),
    ];
    if let Some(settings) = &report.settings {
        texts.push(("seed", settings.seed.to_string()));
        // Plain data always serialises; what could not is better left out than told wrongly.
        texts.extend(serde_json::to_string(settings).ok().map(|json| ("settings", json)));
    }
    let numbers = [
        ("voxelSize", report.counts.voxel_size),
        ("patches", report.counts.patches as f64),
        ("rays", report.rows.rays as f64),
        ("residual", report.solver.residual),
        ("energyImbalanceR", report.energy.imbalance[0]),
        ("energyImbalanceG", report.energy.imbalance[1]),
        ("energyImbalanceB", report.energy.imbalance[2]),
    ];
    let errors = report.error.iter().flat_map(|e| {
        [("errorDirect", e.direct.total), ("errorIndirect", e.indirect.total), ("errorTotal", e.total.total)]
    });
    let texts = texts.into_iter().map(|(name, text)| (name, ExrAttribute::Text(text)));
    let numbers = numbers.into_iter().chain(errors).map(|(name, number)| (name, ExrAttribute::Float(number as f32)));
    texts.chain(numbers).map(|(name, value)| (format!("luxel.{name}"), value)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        BakeOptions,
        output::exr::{self, Compression},
    };

    #[test]
    fn layers_and_certificate_read_back() {
        let ramp = |k: f32| (0..6).map(|i| Vec3::new(k, i as f32, -k)).collect::<Vec<_>>();
        let preview = Preview {
            width: 3,
            height: 2,
            direct: ramp(1.0),
            exitance: ramp(2.0),
            secondary: ramp(3.0),
            combined: ramp(1e6),
            albedo: ramp(0.5),
            normal: ramp(0.25),
            depth: vec![1.0, 2.0, 3.0, 4.0, 5.0, f32::INFINITY],
            shines: vec![false; 6],
        };
        let mut report = Report { settings: Some(BakeOptions { seed: 7, ..Default::default() }), ..Default::default() };
        report.solver.residual = 0.5;
        report.error = Some(crate::report::ErrorReport::default());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("preview.exr");
        exr::write(&path, &image(&preview, &report), Compression::Zip).unwrap();
        let back = exr::read(&path).unwrap();
        let values = |name: &str| &back.channels.iter().find(|c| c.name == name).expect(name).values;
        assert_eq!(back.channels.len(), 22);
        assert_eq!(*values("R"), vec![1e6; 6]);
        assert_eq!(*values("direct.R"), vec![1.0; 6]);
        assert_eq!(*values("exitance.G"), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(*values("secondary.B"), vec![-3.0; 6]);
        assert_eq!(*values("albedo.R"), vec![0.5; 6]);
        assert_eq!(*values("normal.Z"), vec![-0.25; 6]);
        assert_eq!(*values("depth.Z"), preview.depth);
        let attribute = |name: &str| back.attributes.iter().find(|(n, _)| n == name).map(|(_, v)| v.clone());
        assert_eq!(attribute("luxel.seed"), Some(ExrAttribute::Text("7".into())));
        assert_eq!(attribute("luxel.residual"), Some(ExrAttribute::Float(0.5)));
        assert_eq!(attribute("luxel.errorTotal"), Some(ExrAttribute::Float(0.0)));
        let Some(ExrAttribute::Text(settings)) = attribute("luxel.settings") else { panic!("no settings") };
        assert!(settings.contains("\"rays\":256"), "{settings}");
    }
}
