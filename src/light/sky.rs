//! Light from infinity: a constant sky and lat-long images.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Quat, Vec3};

use crate::{sampling, scene::light::Environment};

/// Radiance of directions that meet no surface.
#[derive(Clone, Debug, Default)]
pub(super) struct Sky {
    /// The same from everywhere, W/m2/sr.
    pub constant: Vec3,
    /// Images.
    pub maps: Vec<Map>,
}

impl Sky {
    /// Radiance from unit `direction`, W/m2/sr.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        self.maps.iter().fold(self.constant, |sum, map| sum + map.radiance(map.texel(direction)))
    }

    /// A bound of the mean radiance of the channels.
    pub fn largest(&self) -> f64 {
        let map = |m: &Map| m.texels.iter().map(|&t| mean(t)).fold(0.0, f64::max);
        mean(self.constant) + self.maps.iter().map(map).sum::<f64>()
    }

    /// Whether any light comes from the sky.
    pub fn is_lit(&self) -> bool {
        self.constant != Vec3::ZERO || !self.maps.is_empty()
    }
}

/// A lat-long image and the distribution of its light.
#[derive(Clone, Debug)]
pub(super) struct Map {
    width: usize,
    height: usize,
    texels: Vec<Vec3>,
    /// World direction to image frame.
    to_image: Quat,
    /// Running sums of (luminance x solid angle), a row of `width` after another.
    columns: Vec<f64>,
    /// Running sums of the rows' totals.
    rows: Vec<f64>,
    /// Whether cosine-distributed rays alone would be noisy.
    pub uneven: bool,
}

impl Map {
    /// Prepares an image; none if it is black or has no texels. Texels that are negative or not finite count as black.
    pub fn new(image: &Environment) -> Option<Map> {
        let (width, height) = (image.width as usize, image.height as usize);
        if width == 0 || height == 0 || image.texels.len() < width * height {
            return None;
        }
        let clean = |t: &Vec3| if t.is_finite() { t.max(Vec3::ZERO) } else { Vec3::ZERO };
        let texels: Vec<Vec3> = image.texels[..width * height].iter().map(clean).collect();
        let up = image.up.try_normalize().unwrap_or(Vec3::Y);

        let (mut columns, mut rows) = (Vec::with_capacity(texels.len()), Vec::with_capacity(height));
        let (mut total, mut squares) = (0.0, 0.0);
        for (y, row) in texels.chunks_exact(width).enumerate() {
            let solid_angle = row_height(y, height) * TAU / width as f64;
            let mut sum = 0.0;
            for texel in row {
                let light = mean(*texel);
                sum += light * solid_angle;
                squares += light * light * solid_angle;
                columns.push(sum);
            }
            total += sum;
            rows.push(total);
        }
        // Relative second moment over the sphere: 1 for constant radiance, about 1e4 with a sun.
        let uneven = squares * 4.0 * PI > 2.0 * total * total;
        (total > 0.0 && total.is_finite()).then(|| Map {
            width,
            height,
            texels,
            to_image: Quat::from_rotation_arc(Vec3::Y, up).inverse(),
            columns,
            rows,
            uneven,
        })
    }

    /// The texel seen in unit `direction`.
    pub fn texel(&self, direction: Vec3) -> usize {
        let d = self.to_image * direction;
        let u = (d.x.atan2(-d.z) as f64 + PI) / TAU;
        let v = (d.y.clamp(-1.0, 1.0) as f64).acos() / PI;
        let index = |x: f64, n: usize| ((x * n as f64) as usize).min(n - 1);
        index(v, self.height) * self.width + index(u, self.width)
    }

    /// Radiance of a texel, W/m2/sr.
    pub fn radiance(&self, texel: usize) -> Vec3 {
        self.texels[texel]
    }

    /// Density of [`Map::sample`], 1/sr.
    pub fn pdf(&self, texel: usize) -> f64 {
        // Luminance over its integral: the solid angle of the texel cancels.
        mean(self.texels[texel]) / self.rows[self.height - 1]
    }

    /// A direction with density in proportion to luminance, and its texel.
    pub fn sample(&self, u: f32, v: f32) -> (Vec3, usize) {
        let (y, fy) = sampling::step_of(&self.rows, v as f64);
        let (x, fx) = sampling::step_of(&self.columns[y * self.width..][..self.width], u as f64);
        let azimuth = TAU * (x as f64 + fx) / self.width as f64 - PI;
        let (top, bottom) = (polar_cosine(y, self.height), polar_cosine(y + 1, self.height));
        let cos = top + (bottom - top) * fy;
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let d = DVec3::new(sin * azimuth.sin(), cos, -sin * azimuth.cos()).as_vec3();
        (self.to_image.inverse() * d, y * self.width + x)
    }
}

/// Mean of the channels: what light is weighed by where it must be one number.
pub(super) fn mean(rgb: Vec3) -> f64 {
    (rgb.x as f64 + rgb.y as f64 + rgb.z as f64) / 3.0
}

fn polar_cosine(row: usize, height: usize) -> f64 {
    (PI * row as f64 / height as f64).cos()
}

/// Height of a row on the unit sphere (Archimedes: area = height x azimuth).
fn row_height(y: usize, height: usize) -> f64 {
    polar_cosine(y, height) - polar_cosine(y + 1, height)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: u32, height: u32, up: Vec3, f: impl Fn(u32, u32) -> f32) -> Environment {
        let texels = (0..width * height).map(|i| Vec3::splat(f(i % width, i / width))).collect();
        Environment { width, height, texels, up }
    }

    #[test]
    fn samples_fall_in_the_texel_that_lookup_finds() {
        for up in [Vec3::Y, Vec3::Z, -Vec3::Y, Vec3::new(1.0, 2.0, -0.5).normalize()] {
            let map = Map::new(&image(7, 5, up, |x, y| (x * 3 + y) as f32)).unwrap();
            let mut off = 0;
            for i in 0..64 {
                for j in 0..64 {
                    let (d, texel) = map.sample((i as f32 + 0.5) / 64.0, (j as f32 + 0.5) / 64.0);
                    assert!((d.length() - 1.0).abs() < 1e-5);
                    // A sample within rounding of a border may be read from the neighbour.
                    off += (map.texel(d) != texel) as u32;
                }
            }
            assert!(off < 4, "{off} of 4096 samples are in another texel");
        }
    }

    #[test]
    fn density_integrates_to_one() {
        let map = Map::new(&image(16, 8, Vec3::Y, |x, y| ((x * 7 + y * 13) % 5) as f32)).unwrap();
        let integral: f64 = (0..16 * 8).map(|i| map.pdf(i) * row_height(i / 16, 8) * TAU / 16.0).sum();
        assert!((integral - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_zenith_is_the_first_row_and_minus_z_the_middle_column() {
        let map = Map::new(&image(8, 4, Vec3::Y, |_, _| 1.0)).unwrap();
        assert_eq!(map.texel(Vec3::Y) / 8, 0);
        assert_eq!(map.texel(-Vec3::Y) / 8, 3);
        assert_eq!(map.texel(Vec3::new(0.01, 0.0, -1.0).normalize()) % 8, 4);
        assert_eq!(map.texel(Vec3::new(1.0, 0.0, 0.01).normalize()) % 8, 6);
    }

    #[test]
    fn bad_images_give_no_light_and_no_panic() {
        assert!(Map::new(&image(0, 0, Vec3::Y, |_, _| 1.0)).is_none());
        assert!(Map::new(&image(4, 2, Vec3::Y, |_, _| f32::NAN)).is_none());
        assert!(Map::new(&image(4, 2, Vec3::ZERO, |x, _| if x == 0 { f32::INFINITY } else { 1.0 })).is_some());
        assert!(Map::new(&Environment { width: 9, height: 9, texels: vec![], up: Vec3::Y }).is_none());
    }
}
