//! EXR images: the light of luxel's previews, or all colours of any other.

use std::path::Path;

use super::table::{Layer, Table};
use crate::{
    Error, Result,
    output::exr::{self, ExrImage},
};

/// The layers of `preview.exr` that hold light, and what they are called here.
const PREVIEW: [(&str, &str); 3] = [("direct.", "direct"), ("secondary.", "indirect"), ("combined.", "total")];

/// Reads the colours of an image. Of luxel's previews these are direct, secondary (here `indirect`) and combined (here
/// `total`) radiance; of others every layer with channels R, G, B, the one without a name being `total`.
pub fn read(path: &Path) -> Result<Table> {
    let image = exr::read(path)?;
    let layer = |prefix: &str, name: &str| {
        let [r, g, b] = ["R", "G", "B"].map(|band| channel(&image, &format!("{prefix}{band}")));
        Some(Layer { name: name.into(), bands: [r?, g?, b?], errors: None })
    };
    let mut layers: Vec<Layer> = PREVIEW.iter().filter_map(|(prefix, name)| layer(prefix, name)).collect();
    if layers.len() < PREVIEW.len() {
        let prefixes = image.channels.iter().filter_map(|c| c.name.strip_suffix('R'));
        let named = |prefix: &str| if prefix.is_empty() { "total" } else { prefix.trim_end_matches('.') }.to_string();
        layers = prefixes.filter_map(|prefix| layer(prefix, &named(prefix))).collect();
    }
    if layers.is_empty() {
        return Err(Error::input(path, "", "no colours: channels R, G and B were expected"));
    }
    Ok(Table { layers, positions: None, size: Some((image.width, image.height)) })
}

fn channel(image: &ExrImage, name: &str) -> Option<Vec<f64>> {
    let channel = image.channels.iter().find(|c| c.name == name)?;
    Some(channel.values.iter().map(|&v| v as f64).collect())
}
