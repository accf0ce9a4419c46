//! Environment images as paths look for them: a coarse grid of cells, picked by their light.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Quat, Vec3};

use crate::{sampling, scene::light::Environment};

/// Rows of cells at most; columns are twice as many.
const MOST_ROWS: usize = 256;

/// A lat-long image, and cells of it with their share of the light.
pub(super) struct Map {
    width: usize,
    height: usize,
    texels: Vec<Vec3>,
    /// From the world to the image.
    turn: Quat,
    rows: usize,
    columns: usize,
    /// Running sums of the cells' light in each row, then of the rows.
    along: Vec<f64>,
    down: Vec<f64>,
}

impl Map {
    /// None if the image is black or broken. Texels that are negative or not finite count as black.
    pub fn new(image: &Environment) -> Option<Map> {
        let (width, height) = (image.width as usize, image.height as usize);
        if width == 0 || height == 0 || image.texels.len() < width * height {
            return None;
        }
        let clean = |t: &Vec3| if t.is_finite() { t.max(Vec3::ZERO) } else { Vec3::ZERO };
        let texels: Vec<Vec3> = image.texels[..width * height].iter().map(clean).collect();
        let (rows, columns) = (height.min(MOST_ROWS), width.min(2 * MOST_ROWS));
        let mut light = vec![0.0; rows * columns];
        // Texels that lie in several cells count in each: a cell must not be dark where a part of it is not.
        for y in 0..height {
            let solid_angle = (polar_cosine(y, height) - polar_cosine(y + 1, height)) * TAU / width as f64;
            for x in 0..width {
                let t = texels[y * width + x];
                let value = (t.x as f64 + t.y as f64 + t.z as f64) / 3.0 * solid_angle;
                for row in y * rows / height..=((y + 1) * rows - 1) / height {
                    for column in x * columns / width..=((x + 1) * columns - 1) / width {
                        light[row * columns + column] += value;
                    }
                }
            }
        }
        let running = |sum: &mut f64, x: f64| {
            *sum += x;
            Some(*sum)
        };
        let along: Vec<f64> =
            light.chunks_exact(columns).flat_map(|row| row.iter().copied().scan(0.0, running)).collect();
        let down: Vec<f64> = along.chunks_exact(columns).map(|row| row[columns - 1]).scan(0.0, running).collect();
        let total = down[rows - 1];
        let up = image.up.try_normalize().unwrap_or(Vec3::Y);
        let turn = Quat::from_rotation_arc(Vec3::Y, up).inverse();
        (total > 0.0 && total.is_finite()).then_some(Map { width, height, texels, turn, rows, columns, along, down })
    }

    /// Radiance of a mean channel over the sphere, about.
    pub fn total(&self) -> f64 {
        self.down[self.rows - 1]
    }

    /// Radiance from unit `direction`.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let [u, v] = self.place(direction);
        self.texels[step(v, self.height) * self.width + step(u, self.width)]
    }

    /// Density of [`Map::sample`] at unit `direction`, 1/sr.
    pub fn density(&self, direction: Vec3) -> f32 {
        let [u, v] = self.place(direction);
        self.cell_density(step(v, self.rows), step(u, self.columns))
    }

    /// A direction, with density in proportion to the light of its cell; and that density, 1/sr.
    pub fn sample(&self, u: f32, v: f32) -> (Vec3, f32) {
        let (row, down) = sampling::step_of(&self.down, v as f64);
        let (column, along) = sampling::step_of(&self.along[row * self.columns..][..self.columns], u as f64);
        let azimuth = TAU * (column as f64 + along) / self.columns as f64 - PI;
        let (top, bottom) = (polar_cosine(row, self.rows), polar_cosine(row + 1, self.rows));
        let cos = top + (bottom - top) * down;
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let d = DVec3::new(sin * azimuth.sin(), cos, -sin * azimuth.cos()).as_vec3();
        (self.turn.inverse() * d, self.cell_density(row, column))
    }

    fn cell_density(&self, row: usize, column: usize) -> f32 {
        let at = row * self.columns + column;
        let light = self.along[at] - if column > 0 { self.along[at - 1] } else { 0.0 };
        let solid_angle = (polar_cosine(row, self.rows) - polar_cosine(row + 1, self.rows)) * TAU / self.columns as f64;
        (light / self.total() / solid_angle) as f32
    }

    /// Place in the image, from its upper left corner.
    fn place(&self, direction: Vec3) -> [f64; 2] {
        let d = self.turn * direction;
        [(d.x.atan2(-d.z) as f64 + PI) / TAU, (d.y.clamp(-1.0, 1.0) as f64).acos() / PI]
    }
}

fn step(x: f64, n: usize) -> usize {
    ((x * n as f64) as usize).min(n - 1)
}

fn polar_cosine(row: usize, rows: usize) -> f64 {
    (PI * row as f64 / rows as f64).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 7 x 5 texels, and more of them than cells: the density integrates to one and tells where samples fall.
    #[test]
    fn samples_fall_as_densely_as_the_density_says() {
        for (width, height) in [(7, 5), (700, 300)] {
            let texels = (0..width * height).map(|i| Vec3::splat(((i * 7919) % 13 + 1) as f32)).collect();
            let image = Environment { width, height, texels, up: Vec3::new(1.0, 2.0, -0.5).normalize() };
            let map = Map::new(&image).unwrap();
            let n = 1 << 16;
            let (mut sum, mut squares, mut off) = (0.0, 0.0, 0);
            for i in 0..n {
                let [u, v, ..] = crate::sampling::sobol4(i, 5);
                let (d, density) = map.sample(u, v);
                off += ((map.density(d) / density - 1.0).abs() > 1e-3) as u32;
                // The integral of 1 over the directions with y > 0.2 of the world: 0.8 tau.
                let value = if d.y > 0.2 { 1.0 / density as f64 } else { 0.0 };
                sum += value / n as f64;
                squares += value * value / n as f64;
            }
            let error = ((squares - sum * sum) / n as f64).sqrt();
            assert!((sum - 0.8 * TAU).abs() < 4.0 * error, "{sum} +- {error}");
            // Those within rounding of a border.
            assert!(off < n / 200, "{off}");
        }
    }
}
