//! Which settings are compared.

use serde::Serialize;

use crate::{
    BakeOptions,
    options::{Backend, PatchSource, Reconstruct, Resolution},
    selftest,
};

/// Patch sources, ways to carry light to points: one line each.
pub(super) const SOURCES: [PatchSource; 5] =
    [PatchSource::Surfels, PatchSource::Faces, PatchSource::Decimated, PatchSource::Clustered, PatchSource::Proxy];
pub(super) const RECONSTRUCTIONS: [Reconstruct; 4] =
    [Reconstruct::Smooth, Reconstruct::Nearest4, Reconstruct::Gather, Reconstruct::Adaptive];

/// Grids and rays of the full sweep.
const GRIDS: [u32; 4] = [16, 32, 64, 128];
const RAYS: [u32; 3] = [64, 256, 1024];
/// Grids and rays of the quick one, for the default patches; all else is compared at one of each.
const QUICK_GRIDS: [u32; 3] = [16, 32, 64];
const QUICK_RAYS: [u32; 2] = [64, 256];
const QUICK_GRID: u32 = 32;
const QUICK_RAY: u32 = 256;
/// Paths a point of the path tracer's curve.
pub const PATHS: [u32; 4] = [16, 64, 256, 1024];

/// How much is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// The default patches at a few sizes, each other choice once.
    Quick,
    /// Everything with everything.
    Full,
}

/// The settings of one point of the plot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Configuration {
    /// What the patches are.
    pub patches: PatchSource,
    /// Voxels on the longest side.
    pub grid: u32,
    /// Form-factor rays a patch.
    pub rays: u32,
    /// From patches to points.
    pub reconstruct: Reconstruct,
    /// Ray tracer.
    pub backend: Backend,
}

impl Configuration {
    /// The bake's settings.
    pub fn options(&self, seed: u64) -> BakeOptions {
        BakeOptions {
            resolution: Resolution::Grid(self.grid),
            patches: self.patches,
            rays: self.rays,
            reconstruct: self.reconstruct,
            backend: self.backend,
            seed,
            ..BakeOptions::default()
        }
    }

    /// The curve that it is a point of.
    pub fn series(&self) -> String {
        format!("{}, {}, {}", word(&self.patches), word(&self.reconstruct), word(&self.backend))
    }
}

/// As files and the command line write an enum.
pub fn word<T: Serialize>(value: &T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(text)) => text,
        _ => String::new(),
    }
}

/// All configurations of a sweep, the cheap ones first. Those of [`PatchSource::Proxy`] are for scenes that have one.
pub fn configurations(extent: Extent) -> Vec<Configuration> {
    // Brute force answers as the others do, in more time.
    let backends: Vec<Backend> = selftest::backends().into_iter().filter(|b| *b != Backend::Brute).collect();
    let mut all = Vec::new();
    match extent {
        Extent::Full => {
            for (grid, rays) in GRIDS.into_iter().flat_map(|g| RAYS.map(|r| (g, r))) {
                for (patches, reconstruct) in SOURCES.into_iter().flat_map(|p| RECONSTRUCTIONS.map(|r| (p, r))) {
                    all.extend(backends.iter().map(|&backend| Configuration {
                        patches,
                        grid,
                        rays,
                        reconstruct,
                        backend,
                    }));
                }
            }
        }
        Extent::Quick => {
            let base = Configuration {
                patches: SOURCES[0],
                grid: QUICK_GRID,
                rays: QUICK_RAY,
                reconstruct: RECONSTRUCTIONS[0],
                backend: backends[0],
            };
            let sizes =
                QUICK_GRIDS.into_iter().flat_map(|grid| QUICK_RAYS.map(|rays| Configuration { grid, rays, ..base }));
            all.extend(sizes);
            all.extend(SOURCES[1..].iter().map(|&patches| Configuration { patches, ..base }));
            all.extend(RECONSTRUCTIONS[1..].iter().map(|&reconstruct| Configuration { reconstruct, ..base }));
            all.extend(backends[1..].iter().map(|&backend| Configuration { backend, ..base }));
            // The paper's method to the letter.
            all.push(Configuration { patches: PatchSource::Faces, reconstruct: Reconstruct::Nearest4, ..base });
            all.sort_by_key(|c| c.grid);
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_configuration_comes_twice_and_the_quick_ones_are_few() {
        for extent in [Extent::Quick, Extent::Full] {
            let all = configurations(extent);
            assert!(all.iter().enumerate().all(|(i, c)| !all[..i].contains(c)), "{extent:?}");
            for source in SOURCES {
                assert!(all.iter().any(|c| c.patches == source), "{extent:?}: {source:?}");
            }
            for reconstruct in RECONSTRUCTIONS {
                assert!(all.iter().any(|c| c.reconstruct == reconstruct), "{extent:?}: {reconstruct:?}");
            }
        }
        assert!(configurations(Extent::Quick).len() < 20);
        assert!(configurations(Extent::Full).len() > 40);
    }

    #[test]
    fn a_series_is_named_as_its_options_are() {
        let c = configurations(Extent::Quick)[0];
        assert!(c.series().starts_with("surfels, smooth, "), "{}", c.series());
    }
}
