//! Colours of cut-out textures, such as leaves.
//!
//! What an image holds where it is clear has no meaning: often black. But a triangle that is opaque on the whole counts as
//! opaque all over ([`Builder::build`]), so its clear texels take the colour of the opaque ones around them.

use std::collections::HashMap;

use glam::{Vec2, Vec3};

use super::{Builder, Opacity, OpacityMap, Texture};

impl Builder {
    /// Gives clear texels of all materials with an opacity map the colour of what is opaque nearby.
    pub(super) fn colour_clear_texels(&mut self) {
        let mut filled: HashMap<(u32, u32, Option<u32>), u32> = HashMap::new();
        for material in &mut self.materials {
            let Opacity { texture: Some(map), cutoff, .. } = material.opacity else { continue };
            let Some(texture) = &mut material.surface.albedo_texture else { continue };
            *texture = *filled.entry((*texture, map, cutoff.map(f32::to_bits))).or_insert_with(|| {
                let cut = fill(&self.textures[*texture as usize], &self.opacity_maps[map as usize], cutoff);
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

/// The texture with its clear texels (all below `cutoff`; those of opacity 0 without one) filled from the mean colour of
/// the smallest square around them, of a pyramid of halved images, that holds something opaque. Means are weighted by
/// opacity. A texture without opaque texels stays.
fn fill(texture: &Texture, map: &OpacityMap, cutoff: Option<f32>) -> Texture {
    let (width, height) = (texture.width as usize, texture.height as usize);
    let weight = |i: usize| {
        let at = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5) / Vec2::new(width as f32, height as f32);
        let opacity = map.sample(at);
        cutoff.map_or(opacity, |c| if opacity >= c { 1.0 } else { 0.0 })
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

    #[test]
    fn clear_texels_take_the_colour_of_what_is_opaque_around_them() {
        let (green, red) = (Vec3::new(0.1, 0.5, 0.1), Vec3::new(0.6, 0.1, 0.1));
        // 3 x 2 texels: green and a clear one above, a clear one between; red on the right.
        let texels = vec![green, Vec3::ZERO, red, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO];
        let texture = Texture { width: 3, height: 2, texels };
        let map = OpacityMap { width: 3, height: 2, texels: vec![1.0, 0.2, 0.6, 0.0, 0.0, 0.0] };
        assert_eq!(fill(&texture, &map, Some(0.5)).texels, [green, green, red, green, green, red]);
        // Without a cutoff what shimmers through has its own colour, and its weight.
        let mean = green / 1.2;
        let filled = fill(&texture, &map, None).texels;
        assert_eq!(filled[..3], texture.texels[..3]);
        assert!((filled[3] - mean).abs().max_element() < 1e-6, "{filled:?}");
        // Nothing is opaque: nothing is known.
        let clear = OpacityMap { width: 1, height: 1, texels: vec![0.0] };
        assert_eq!(fill(&texture, &clear, None), texture);
    }
}
