//! Colours of cut-out textures, such as leaves.
//!
//! What an image holds where it is clear has no meaning: often black. But a triangle that is opaque on the whole counts as
//! opaque all over ([`Builder::build`]), so its clear texels take the colour of the opaque ones around them.

use std::collections::HashMap;

use glam::{Vec2, Vec3};

use super::{Builder, Opacity, Texture};

impl Builder {
    /// Gives clear texels of all materials with an opacity map the colour of what is opaque nearby.
    pub(super) fn colour_clear_texels(&mut self) {
        let mut filled: HashMap<(u32, u32, u32, Option<u32>), u32> = HashMap::new();
        for material in &mut self.materials {
            let Opacity { factor, texture: Some(map), cutoff } = material.opacity else { continue };
            let Some(texture) = &mut material.surface.albedo_texture else { continue };
            let key = (*texture, map, factor.to_bits(), cutoff.map(f32::to_bits));
            *texture = *filled.entry(key).or_insert_with(|| {
                let opacity_map = &self.opacity_maps[map as usize];
                let cut = fill(&self.textures[*texture as usize], |uv| material.opacity.at(opacity_map, uv));
                self.textures.push(cut);
                self.textures.len() as u32 - 1
            });
        }
    }
}

/// One level of a pyramid: sums of colours, and in the fourth place of their weights.
struct Level {
    width: usize,
    height: usize,
    sums: Vec<glam::Vec4>,
}

/// The texture with its texels of `opacity` 0 filled from the mean colour of the smallest square around them, of a pyramid of
/// halved images, that holds something opaque. Means are weighted by opacity. A texture without opaque texels stays.
fn fill(texture: &Texture, opacity: impl Fn(Vec2) -> f32) -> Texture {
    let (width, height) = (texture.width as usize, texture.height as usize);
    let weight = |i: usize| {
        opacity(Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5) / Vec2::new(width as f32, height as f32))
    };
    let sums = texture.texels.iter().enumerate().map(|(i, c)| (*c * weight(i)).extend(weight(i))).collect();
    let mut levels = vec![Level { width, height, sums }];
    while let Some(Level { width, height, sums }) = levels.last().filter(|l| l.sums.len() > 1) {
        let (w, h) = (width.div_ceil(2), height.div_ceil(2));
        let mut halved = vec![glam::Vec4::ZERO; w * h];
        for (i, sum) in sums.iter().enumerate() {
            halved[i / width / 2 * w + i % width / 2] += *sum;
        }
        levels.push(Level { width: w, height: h, sums: halved });
    }
    let around = |i: usize| {
        levels.iter().enumerate().skip(1).find_map(|(k, level)| {
            let sum = level.sums[((i / width) >> k) * level.width + ((i % width) >> k)];
            (sum.w > 0.0).then(|| sum.truncate() / sum.w)
        })
    };
    let texels: Vec<Vec3> = (texture.texels.iter().enumerate())
        .map(|(i, own)| if levels[0].sums[i].w > 0.0 { *own } else { around(i).unwrap_or(*own) })
        .collect();
    Texture { texels, ..*texture }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::OpacityMap;

    #[test]
    fn clear_texels_take_the_colour_of_what_is_opaque_around_them() {
        let (green, red) = (Vec3::new(0.1, 0.5, 0.1), Vec3::new(0.6, 0.1, 0.1));
        // 3 x 2 texels: green and a clear one above, a clear one between; red on the right.
        let texels = vec![green, Vec3::ZERO, red, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO];
        let texture = Texture { width: 3, height: 2, texels };
        let map = OpacityMap { width: 3, height: 2, texels: vec![1.0, 0.2, 0.6, 0.0, 0.0, 0.0] };
        let filled = |factor: f32, cutoff: Option<f32>| {
            fill(&texture, |uv| Opacity { factor, texture: Some(0), cutoff }.at(&map, uv)).texels
        };
        assert_eq!(filled(1.0, Some(0.5)), [green, green, red, green, green, red]);
        // At four fifths of its opacity the red texel is clear too.
        assert_eq!(filled(0.8, Some(0.5)), [green; 6]);
        // Without a cutoff what shimmers through has its own colour, and its weight.
        let mean = green / 1.2;
        let filled = filled(1.0, None);
        assert_eq!(filled[..3], texture.texels[..3]);
        assert!((filled[3] - mean).abs().max_element() < 1e-6, "{filled:?}");
        // Nothing is opaque: nothing is known.
        assert_eq!(fill(&texture, |_| 0.0), texture);
    }
}
