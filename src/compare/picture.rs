//! Pictures of a difference.

use glam::Vec3;

use super::table::{Layer, Table};
use crate::output::exr::{ExrChannel, ExrImage};

/// The difference `a` - `b` of every layer that both have, channels named `layer.R`; none if they are no images of one
/// size.
pub fn difference_image(a: &Table, b: &Table) -> Option<ExrImage> {
    let (width, height) = a.size.filter(|_| a.size == b.size)?;
    let mut channels = Vec::new();
    for layer in &a.layers {
        let Some(reference) = b.layers.iter().find(|l| l.name == layer.name) else { continue };
        for (c, band) in ["R", "G", "B"].iter().enumerate() {
            let pairs = layer.bands[c].iter().zip(&reference.bands[c]);
            let values = pairs.map(|(a, b)| (a - b) as f32).collect();
            channels.push(ExrChannel { name: format!("{}.{band}", layer.name), half: false, values });
        }
    }
    Some(ExrImage { width, height, channels, attributes: Vec::new() })
}

/// Colours, linear, of the difference of luminance: white where there is none, red where `a` is brighter, blue where it
/// is darker, full at `full` (absolute).
pub fn difference_picture(a: &Layer, b: &Layer, full: f64) -> Vec<Vec3> {
    let colour = |difference: f64| {
        let share = if full > 0.0 { (difference / full).clamp(-1.0, 1.0) as f32 } else { 0.0 };
        let rest = 1.0 - share.abs();
        if share > 0.0 { Vec3::new(1.0, rest, rest) } else { Vec3::new(rest, rest, 1.0) }
    };
    a.luminance().iter().zip(b.luminance()).map(|(a, b)| colour(a - b)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brighter_is_red_darker_is_blue_and_equal_is_white() {
        let layer = |values: [f64; 3]| Layer {
            name: "total".into(),
            bands: [values.to_vec(), values.to_vec(), values.to_vec()],
            errors: None,
        };
        let (a, b) = (layer([1.0, 3.0, 1.5]), layer([1.0, 1.0, 2.0]));
        let picture = difference_picture(&a, &b, 1.0);
        assert_eq!(picture, [Vec3::ONE, Vec3::new(1.0, 0.0, 0.0), Vec3::new(0.5, 0.5, 1.0)]);
        let table = |layer| Table { layers: vec![layer], positions: None, size: Some((3, 1)) };
        let image = difference_image(&table(a), &table(b)).unwrap();
        assert_eq!(image.channels[0].values, [0.0, 2.0, -0.5]);
        assert_eq!(image.channels[2].name, "total.B");
        assert!(difference_image(&Table::default(), &Table::default()).is_none());
    }
}
