//! What compares: light at points or pixels, read from CSV, PLY or EXR files.

use std::path::Path;

use super::{csv, exr, ply};
use crate::{Error, Result, colour::luminance_f64};

/// One kind of light: values of three bands for every point or pixel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layer {
    /// `direct`, `indirect`, `total`, or the layer's name in an EXR file.
    pub name: String,
    /// Red, green, blue.
    pub bands: [Vec<f64>; 3],
    /// Standard errors of the bands, then of the luminance, where the file knows them.
    pub errors: Option<[Vec<f64>; 4]>,
}

impl Layer {
    /// Luminance of every point or pixel.
    pub fn luminance(&self) -> Vec<f64> {
        (0..self.bands[0].len()).map(|i| luminance_f64([0, 1, 2].map(|c| self.bands[c][i]))).collect()
    }
}

/// What a file holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Kinds of light.
    pub layers: Vec<Layer>,
    /// Positions, world units, where the file has them.
    pub positions: Option<Vec<[f64; 3]>>,
    /// Width and height of an image.
    pub size: Option<(u32, u32)>,
}

/// Reads `path` by its extension: `.csv`, `.ply` or `.exr`.
///
/// # Errors
/// [`Error::Io`]; [`Error::Input`] if the content is wrong, lacks what is compared or is not finite, with the place;
/// [`Error::Option`] for another extension.
pub fn read(path: &Path) -> Result<Table> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let table = match extension.as_str() {
        "csv" => csv::read(path)?,
        "ply" => ply::read(path)?,
        "exr" => exr::read(path)?,
        _ => {
            let message = "cannot be compared: a .csv, .ply or .exr file was expected";
            return Err(Error::Option(format!("{}: {message}", path.display())));
        }
    };
    for layer in &table.layers {
        for (band, values) in ["red", "green", "blue"].iter().zip(&layer.bands) {
            if let Some(i) = values.iter().position(|v| !v.is_finite()) {
                let place = match table.size {
                    Some((width, _)) => format!("pixel {}, {}", i % width as usize, i / width as usize),
                    None => format!("point {}", i + 1),
                };
                let message = format!("{} {band} is {}: only finite values can be compared", layer.name, values[i]);
                return Err(Error::input(path, place, message));
            }
        }
        let mut errors = layer.errors.iter().flatten();
        if errors.any(|e| e.iter().any(|e| !(e.is_finite() && *e >= 0.0))) {
            let message = format!("a standard error of {} is not a number of at least 0", layer.name);
            return Err(Error::input(path, "", message));
        }
    }
    Ok(table)
}

/// The columns of points: positions where there are any, direct and indirect light, and their sum where there are both.
pub(super) fn of_columns(path: &Path, names: &[String], mut take: impl FnMut(usize) -> Vec<f64>) -> Result<Table> {
    let mut column = |name: &str| names.iter().position(|n| n == name).map(&mut take);
    let mut three = |names: [String; 3]| {
        let [a, b, c] = names.map(|name| column(&name));
        Some([a?, b?, c?])
    };
    let positions = three(["x", "y", "z"].map(String::from));
    let mut layers = Vec::new();
    for (kind, short) in [("direct", "sd"), ("indirect", "si"), ("total", "st")] {
        let Some(bands) = three(["r", "g", "b"].map(|c| format!("{kind}_{c}"))) else { continue };
        let own = three(["r", "g", "b"].map(|c| format!("{kind}_{c}_se")));
        let errors = own.or_else(|| three(["r", "g", "b"].map(|c| format!("{short}_{c}"))));
        layers.push((kind, bands, errors));
    }
    if layers.is_empty() {
        let message =
            "no light: columns direct_r, direct_g, direct_b or indirect_r, indirect_g, indirect_b were expected";
        return Err(Error::input(path, "", message));
    }
    let sum = |a: &[Vec<f64>; 3], b: &[Vec<f64>; 3], f: fn(f64, f64) -> f64| {
        [0, 1, 2].map(|c| a[c].iter().zip(&b[c]).map(|(&a, &b)| f(a, b)).collect::<Vec<_>>())
    };
    if let [(_, direct, sd), (_, indirect, si)] = layers.as_slice() {
        let total = sum(direct, indirect, |a, b| a + b);
        // Their own noise, if the file does not say better: both halves come from different samples.
        let own = three(["r", "g", "b"].map(|c| format!("total_{c}_se")));
        let both = sd.as_ref().zip(si.as_ref()).map(|(a, b)| sum(a, b, f64::hypot));
        layers.push(("total", total, own.or(both)));
    }
    let layers = layers
        .into_iter()
        .map(|(kind, bands, errors)| {
            let luminance = column(&format!("{kind}_luminance_se"));
            let errors = errors.map(|[r, g, b]| {
                // Where it is not told: as if the bands' errors were independent, the least that it can be.
                let least = |i: usize| {
                    let [r, g, b] = [[r[i], 0.0, 0.0], [0.0, g[i], 0.0], [0.0, 0.0, b[i]]].map(luminance_f64);
                    (r * r + g * g + b * b).sqrt()
                };
                let luminance = luminance.unwrap_or_else(|| (0..r.len()).map(least).collect());
                [r, g, b, luminance]
            });
            Layer { name: kind.into(), bands, errors }
        })
        .collect();
    let positions = positions.map(|[x, y, z]| (0..x.len()).map(|i| [x[i], y[i], z[i]]).collect());
    Ok(Table { layers, positions, size: None })
}
