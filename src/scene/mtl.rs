//! MTL material libraries.
//!
//! Read here and not by tobj: tobj 4.0 panics on a colour with fewer than three numbers (`Kd 0.5`), knows no `Ke`
//! or `Tr`, and gives no line numbers for messages.
//!
//! Rules:
//! - `Kd` is the albedo, taken as linear. Without `Kd`: white times `map_Kd`; 0.5 without a texture that can be read.
//! - `map_Kd` multiplies it; where the file is missing, the factor alone counts.
//! - Mirrors are diffuse here: `illum` 3, 5 or 8, or a black `Kd` without any `illum`, adds `Ks` to the albedo.
//! - `Ke` is the emitted radiance, W/m2/sr; `map_Ke` multiplies it.
//! - Opacity is `d`, or 1 - `Tr`, times `map_d`.

use std::{collections::HashMap, path::Path};

use glam::Vec3;

use super::{
    Material,
    builder::Builder,
    image::{self, OpacityMap},
    obj_scan, path,
    raw::{Opacity, RawMaterial},
};

/// Albedo of surfaces whose material says nothing about it.
pub(crate) const DEFAULT_ALBEDO: Vec3 = Vec3::splat(0.5);

#[derive(Default)]
struct Entry {
    name: String,
    kd: Option<Vec3>,
    ks: Option<Vec3>,
    ke: Option<Vec3>,
    opacity: Option<f32>,
    illum: Option<u32>,
    map_kd: Option<String>,
    map_ke: Option<String>,
    map_d: Option<String>,
}

/// Textures that were read already, by path as the file gives it.
#[derive(Default)]
pub(crate) struct TextureCache {
    colours: HashMap<String, Option<u32>>,
    opacities: HashMap<String, Option<u32>>,
    /// References that could not be followed, with the cause.
    pub missing: Vec<String>,
}

/// Reads the library `file` into `builder`; returns the materials' indices by name. Later entries of the same name
/// replace earlier ones.
pub(crate) fn read(
    file: &Path,
    builder: &mut Builder,
    cache: &mut TextureCache,
    by_name: &mut HashMap<String, u32>,
) -> crate::Result<()> {
    let bytes = std::fs::read(file).map_err(|e| crate::Error::io(file, e))?;
    let text = String::from_utf8_lossy(&bytes);
    let mut entries: Vec<Entry> = Vec::new();
    let mut problems: Vec<String> = Vec::new();
    for (number, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = obj_scan::without_comment(line).trim();
        let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        if key == "newmtl" {
            if entries.iter().any(|e| e.name == rest) {
                problems
                    .push(format!("line {}: material \"{rest}\" is defined again; the last one counts", number + 1));
            }
            entries.push(Entry { name: rest.to_string(), ..Entry::default() });
        } else if let Some(entry) = entries.last_mut()
            && let Err(problem) = entry.statement(key, rest)
        {
            problems.push(format!("line {}: {problem}", number + 1));
        }
    }
    if !problems.is_empty() {
        builder.warn(format!("{}: {}", file.display(), super::builder::list(&problems, 5)));
    }
    for entry in entries {
        let material = entry.resolve(path::folder(file), builder, cache);
        by_name.insert(material.surface.name.clone(), builder.add_material(material));
    }
    Ok(())
}

impl Entry {
    fn statement(&mut self, key: &str, rest: &str) -> Result<(), String> {
        match key {
            "Kd" => self.kd = Some(colour(key, rest)?),
            "Ks" => self.ks = Some(colour(key, rest)?),
            "Ke" => self.ke = Some(colour(key, rest)?),
            "d" => self.opacity = Some(number(rest.trim_start_matches("-halo").trim_start(), key)?),
            // `d` is the standard one: it wins where both are given.
            "Tr" if self.opacity.is_none() => self.opacity = Some(1.0 - number(rest, key)?),
            "illum" => self.illum = number(rest, key).ok().map(|v| v as u32),
            "map_Kd" => self.map_kd = texture_name(rest),
            "map_Ke" => self.map_ke = texture_name(rest),
            "map_d" => self.map_d = texture_name(rest),
            _ => {}
        }
        Ok(())
    }

    fn resolve(self, folder: &Path, builder: &mut Builder, cache: &mut TextureCache) -> RawMaterial {
        let albedo_texture = self.map_kd.as_deref().and_then(|f| cache.colour(folder, f, builder));
        let emission_texture = self.map_ke.as_deref().and_then(|f| cache.colour(folder, f, builder));
        let opacity_texture = self.map_d.as_deref().and_then(|f| cache.opacity(folder, f, builder));
        let mut albedo = self.kd.unwrap_or(if albedo_texture.is_some() { Vec3::ONE } else { DEFAULT_ALBEDO });
        let mirror = matches!(self.illum, Some(3 | 5 | 8)) || (self.illum.is_none() && albedo == Vec3::ZERO);
        if let (true, Some(ks)) = (mirror, self.ks) {
            albedo += ks;
        }
        RawMaterial {
            surface: Material {
                name: self.name,
                albedo,
                emission: self.ke.unwrap_or(if emission_texture.is_some() { Vec3::ONE } else { Vec3::ZERO }),
                albedo_texture,
                emission_texture,
                double_sided: false,
            },
            opacity: Opacity { factor: self.opacity.unwrap_or(1.0), texture: opacity_texture, cutoff: None },
        }
    }
}

impl TextureCache {
    fn colour(&mut self, folder: &Path, reference: &str, builder: &mut Builder) -> Option<u32> {
        if let Some(known) = self.colours.get(reference) {
            return *known;
        }
        let index = self.load(folder, reference).map(|i| builder.add_texture(i.texture));
        self.colours.insert(reference.to_string(), index);
        index
    }

    fn opacity(&mut self, folder: &Path, reference: &str, builder: &mut Builder) -> Option<u32> {
        if let Some(known) = self.opacities.get(reference) {
            return *known;
        }
        // An alpha channel, where there is one, is what tools that write `map_d` mean.
        let index = self
            .load(folder, reference)
            .map(|i| builder.add_opacity_map(i.alpha.unwrap_or_else(|| OpacityMap::from_grey(&i.texture))));
        self.opacities.insert(reference.to_string(), index);
        index
    }

    fn load(&mut self, folder: &Path, reference: &str) -> Option<image::Image> {
        match path::inside(folder, reference).and_then(|p| image::read(&p)) {
            Ok(image) => Some(image),
            Err(cause) => {
                let message = format!("\"{reference}\" ({cause})");
                if !self.missing.contains(&message) {
                    self.missing.push(message);
                }
                None
            }
        }
    }
}

fn number(text: &str, key: &str) -> Result<f32, String> {
    let word = text.split_whitespace().next().unwrap_or("");
    word.parse().map_err(|_| format!("{key} \"{text}\" is no number, ignored"))
}

/// One number stands for grey, as the format says.
fn colour(key: &str, text: &str) -> Result<Vec3, String> {
    let wrong = || format!("{key} \"{text}\" is not one or three numbers, ignored");
    let values: Vec<f32> = text.split_whitespace().map(str::parse).collect::<Result<_, _>>().map_err(|_| wrong())?;
    match values[..] {
        [grey] => Ok(Vec3::splat(grey)),
        [r, g, b, ..] => Ok(Vec3::new(r, g, b)),
        _ => Err(wrong()),
    }
}

/// The file name behind the options (`-s 1 1 1 -clamp on`) of a map statement; names may hold spaces.
fn texture_name(text: &str) -> Option<String> {
    let mut rest = text;
    while let Some(option) = rest.strip_prefix('-') {
        let (name, mut tail) = option.split_once(char::is_whitespace)?;
        let most = match name {
            "o" | "s" | "t" => 3,
            "mm" => 2,
            _ => 1,
        };
        for taken in 0..most {
            let next = tail.trim_start().split_once(char::is_whitespace);
            // Offsets and scales may leave out their last numbers.
            if taken > 0 && next.is_none_or(|(word, _)| word.parse::<f32>().is_err()) {
                break;
            }
            tail = next?.1;
        }
        rest = tail.trim_start();
    }
    (!rest.is_empty()).then(|| rest.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_of_maps_are_not_part_of_the_name() {
        let name = |s| texture_name(s).unwrap();
        assert_eq!(name("a b c.jpg"), "a b c.jpg");
        assert_eq!(name("-s 1 1 1 -clamp on a b.jpg"), "a b.jpg");
        assert_eq!(name("-o 0.5 a.png"), "a.png");
        assert_eq!(texture_name("-clamp on"), None);
    }

    #[test]
    fn colours_are_one_or_three_numbers() {
        assert_eq!(colour("Kd", "0.5").unwrap(), Vec3::splat(0.5));
        assert_eq!(colour("Kd", "1 2 3").unwrap(), Vec3::new(1.0, 2.0, 3.0));
        assert!(colour("Kd", "-0.5 0.2").is_err());
        assert!(colour("Kd", "1,5 0 0").is_err());
        assert!(colour("Kd", "").is_err());
    }
}
