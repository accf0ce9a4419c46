//! What the patches send each other.

use glam::Vec3;

use crate::{
    BakeOptions, Scene,
    light::{self, Bright, Census, Known, LightSet},
    options::{PatchSource, Primary},
    progress::Progress,
    simplify::{self, Simplified},
    skip::{self, Foresight},
    solve::{self, Solution},
    trace::RayTracer,
    transfer::{self, Estimate, FormFactors},
};

/// What light is exchanged between and by.
pub(super) struct Exchange<'a> {
    pub scene: &'a Scene,
    pub simplified: &'a Simplified,
    /// What is sampled by shadow rays.
    pub lights: &'a LightSet,
    /// Tracer of the real surfaces.
    pub tracer: &'a dyn RayTracer,
    /// What spares shadow rays.
    pub foresight: &'a Foresight,
    pub options: &'a BakeOptions,
    pub progress: &'a dyn Progress,
}

/// Primary light of the patches.
pub(super) struct PrimaryLight {
    /// Irradiance, W/m2.
    pub direct: Vec<Vec3>,
    /// The part of it that emitting patches send, where they are senders of the system.
    pub glow: Option<Vec<Vec3>>,
    /// First reflection, W/m2.
    pub source: Vec<[f64; 3]>,
}

/// Patches whose first reflection is sent by shadow rays.
pub(super) struct Sent {
    pub patches: Bright,
    /// The irradiance that they give to every patch, W/m2.
    pub received: Vec<Vec3>,
    /// Shadow rays that it took.
    pub rays: u64,
}

/// Light after the first reflection.
pub(super) struct Secondary {
    /// Irradiance, W/m2.
    pub indirect: Vec<Vec3>,
    /// The part of it that came by form factors.
    pub smooth: Vec<Vec3>,
    /// Reflected radiosity, W/m2.
    pub radiosity: Vec<Vec3>,
    /// The part of it that goes on by form factors: `smooth` is the light of it.
    pub carried: Vec<Vec3>,
}

/// Points on patches that are made at once, to bound their memory.
pub(super) const PATCH_POINTS: usize = 1 << 19;
/// Shadow rays whose power balance is off by more than this share are not used: rows are noisier, but balanced.
const MOST_GAIN: f64 = 0.02;
/// Share of the bright patches' power that may be lost on patches without rows.
const MOST_LOST: f64 = 1e-4;
/// Patches beside lamps are sampled again with so many times the samples,
const BESIDE_SAMPLES: u32 = 8;
/// at most so many,
const MOST_SAMPLES: u32 = 65536;
/// the brightest of them, one in so many of all patches: a quarter more rays at most.
const BESIDE: usize = 32;
/// A patch that is all but hidden is not trusted with more than this factor.
const LEAST_SEEN: f32 = 0.05;

impl Exchange<'_> {
    /// Irradiance of the patches from the lights, over all of their surface; and the shadow rays it took. `census`
    /// learns which lamps reach anything.
    pub fn direct(&self, census: Option<&Census>) -> (Vec<Vec3>, u64) {
        self.sampled(self.lights, census)
    }

    /// Which patches light starts from.
    pub fn lit(&self, direct: &[Vec3]) -> Vec<bool> {
        let glows =
            |i: usize| self.options.primary == Primary::Radiosity && self.simplified.patches.emitted[i] != Vec3::ZERO;
        (0..direct.len()).map(|i| direct[i] != Vec3::ZERO || glows(i)).collect()
    }

    /// Primary light of the visible parts of the patches.
    pub fn primary(&self, direct: &[Vec3], f: &FormFactors) -> PrimaryLight {
        let mut direct = direct.to_vec();
        visible_part(&mut direct, f);
        let patches = &self.simplified.patches;
        let glow = (self.options.primary == Primary::Radiosity).then(|| {
            let emitted: Vec<[f64; 3]> = patches.emitted.iter().map(|&m| rgb(m)).collect();
            let mut received = vec![[0.0; 3]; patches.len()];
            f.multiply(&emitted, &mut received);
            received.into_iter().map(vec3).collect::<Vec<Vec3>>()
        });
        let direct = add(direct, glow.clone());
        let reflected = |(e, a): (&Vec3, &Vec3)| std::array::from_fn(|c| e[c] as f64 * a[c] as f64);
        let source = direct.iter().zip(&patches.albedo).map(reflected).collect();
        PrimaryLight { direct, glow, source }
    }

    /// The bright patches, if any, with what they send.
    pub fn bright(&self, primary: &PrimaryLight, estimate: &Estimate) -> Option<Sent> {
        if self.options.patches != PatchSource::Surfels {
            return None;
        }
        let patches = Bright::choose(self.simplified, &primary.source, &estimate.reached)?;
        let (mut received, rays) = self.sampled(&patches.lights, None);
        visible_part(&mut received, &estimate.form_factors);
        Some(Sent { patches, received, rays })
    }

    /// Adds to `lit` the patches that only bright ones light, whose few rays missed them; false if they get next to
    /// nothing, so that it is not worth new rows.
    pub fn light_more(&self, sent: &Sent, primary: &PrimaryLight, estimate: &Estimate, lit: &mut [bool]) -> bool {
        let f = &estimate.form_factors;
        let dark = |i: usize| !lit[i] && !f.has_row(i) && estimate.visible[i] && sent.received[i] != Vec3::ZERO;
        let more: Vec<usize> = (0..lit.len()).filter(|&i| dark(i)).collect();
        let lost: f64 = more.iter().map(|&i| self.received(sent, f, i)).sum();
        more.iter().for_each(|&i| lit[i] = true);
        lost > MOST_LOST * self.sent(sent, primary, f)
    }

    /// Whether as much power arrives by shadow rays as the bright patches send and does not escape.
    pub fn is_balanced(&self, sent: &Sent, primary: &PrimaryLight, f: &FormFactors) -> bool {
        let arriving = (0..sent.received.len()).filter(|&i| f.has_row(i));
        let arriving: f64 = arriving.map(|i| self.received(sent, f, i)).sum();
        is_balanced(arriving, self.sent(sent, primary, f))
    }

    /// Power that patch `i` gets from the bright ones, all channels.
    fn received(&self, sent: &Sent, f: &FormFactors, i: usize) -> f64 {
        self.seen_area(f, i) * sent.received[i].element_sum() as f64
    }

    /// Power that the bright patches send and that does not escape, all channels.
    fn sent(&self, sent: &Sent, primary: &PrimaryLight, f: &FormFactors) -> f64 {
        let of = |i: usize| self.seen_area(f, i) * primary.source[i].iter().sum::<f64>() * (1.0 - f.escape(i));
        sent.patches.patches.iter().map(|&i| of(i as usize)).sum()
    }

    fn seen_area(&self, f: &FormFactors, i: usize) -> f64 {
        self.simplified.patches.area[i] as f64 * (1.0 - f.hidden(i))
    }

    /// Solves for the light that goes on by form factors, which may have been `spilled` from memory; and how many of the
    /// channels are distinct.
    pub fn secondary(
        &self,
        primary: &PrimaryLight,
        bright: Option<&Sent>,
        f: &FormFactors,
        spilled: bool,
    ) -> (Secondary, Solution, usize) {
        let albedo: Vec<[f64; 3]> = self.simplified.patches.albedo.iter().map(|&a| rgb(a)).collect();
        let mut source = primary.source.clone();
        let mut sent = vec![Vec3::ZERO; source.len()];
        if let Some(bright) = bright {
            bright.patches.patches.iter().for_each(|&i| source[i as usize] = [0.0; 3]);
            for i in (0..source.len()).filter(|&i| f.has_row(i)) {
                sent[i] = bright.received[i];
                source[i] = std::array::from_fn(|c| source[i][c] + albedo[i][c] * sent[i][c] as f64);
            }
        }
        let (solution, bands) = if self.foresight.on {
            skip::solve(f, &albedo, &source, self.options.tolerance, spilled)
        } else {
            (solve::solve(f, &albedo, &source, self.options.tolerance, spilled), 3)
        };
        let smooth: Vec<Vec3> = solution.irradiance.iter().map(|&e| vec3(e)).collect();
        let indirect = add(sent, Some(smooth.clone()));
        let carried: Vec<Vec3> = solution.radiosity.iter().map(|&b| vec3(b)).collect();
        let mut radiosity = carried.clone();
        for &i in bright.iter().flat_map(|b| &b.patches.patches) {
            radiosity[i as usize] += vec3(primary.source[i as usize]);
        }
        (Secondary { indirect, smooth, radiosity, carried }, solution, bands)
    }

    fn sampled(&self, lights: &LightSet, census: Option<&Census>) -> (Vec<Vec3>, u64) {
        let patches = &self.simplified.patches;
        let all: Vec<u32> = (0..patches.len() as u32).collect();
        let samples = self.options.patch_samples;
        self.progress.begin("direct light", (all.len() + all.len() / BESIDE) as u64);
        let (mut direct, beside, mut rays) = self.sample(lights, &all, samples, census);
        // Of the light that is noisy, most is on few patches.
        let power = |i: u32| patches.area[i as usize] * direct[i as usize].element_sum();
        let mut again: Vec<u32> = all.into_iter().filter(|&i| beside[i as usize] && power(i) > 0.0).collect();
        again.sort_by(|&a, &b| power(b).total_cmp(&power(a)).then(a.cmp(&b)));
        again.truncate(patches.len() / BESIDE);
        again.sort_unstable();
        let (better, _, more) = self.sample(lights, &again, (samples * BESIDE_SAMPLES).min(MOST_SAMPLES), census);
        self.progress.end();
        rays += more;
        again.into_iter().zip(better).for_each(|(i, e)| direct[i as usize] = e);
        (direct, rays)
    }

    /// Irradiance of the patches `of`; which of them are beside lamps; and the rays it took.
    fn sample(
        &self,
        lights: &LightSet,
        of: &[u32],
        samples: u32,
        census: Option<&Census>,
    ) -> (Vec<Vec3>, Vec<bool>, u64) {
        let known = Known { view: &|points| self.foresight.of_patch(points), skip: self.foresight.on, census };
        let (mut direct, mut beside) = (Vec::with_capacity(of.len()), Vec::with_capacity(of.len()));
        let mut rays = 0;
        for block in of.chunks((PATCH_POINTS / samples as usize).max(1)) {
            if self.progress.stopped() {
                direct.resize(of.len(), Vec3::ZERO);
                beside.resize(of.len(), false);
                break;
            }
            let mut points = transfer::patch_points(self.simplified, block, samples, self.options.seed);
            // Simplified meshes run through the real surfaces, whose shadows would fall on them.
            if !matches!(self.options.patches, PatchSource::Surfels | PatchSource::Faces) {
                points = simplify::onto_surfaces(self.scene, self.tracer, &points);
            }
            let (per, seed) = (samples as usize, self.options.seed);
            let result = light::irradiance_where(lights, self.tracer, &points, per, samples, seed, &known);
            self.foresight.count(&result);
            direct.extend(result.irradiance);
            beside.extend(light::beside_lamps(lights, &points, per));
            rays += result.rays;
            self.progress.advance(block.len() as u64);
        }
        (direct, beside, rays)
    }
}

/// Whether as much power arrives from bright patches as leaves them and does not escape.
pub(crate) fn is_balanced(arrives: f64, leaves: f64) -> bool {
    (arrives / leaves - 1.0).abs() < MOST_GAIN
}

/// Parts of patches that are hidden were counted as dark; what slips through cracks onto a patch that is hidden
/// altogether is no light.
fn visible_part(irradiance: &mut [Vec3], f: &FormFactors) {
    for (i, e) in irradiance.iter_mut().enumerate() {
        let seen = 1.0 - f.hidden(i) as f32;
        *e = if seen > 0.0 { (*e / seen.max(LEAST_SEEN)).min(Vec3::MAX) } else { Vec3::ZERO };
    }
}

/// Sums, where there is something to add.
pub(super) fn add(mut a: Vec<Vec3>, b: Option<Vec<Vec3>>) -> Vec<Vec3> {
    a.iter_mut().zip(b.into_iter().flatten()).for_each(|(a, b)| *a += b);
    a
}

fn rgb(v: Vec3) -> [f64; 3] {
    v.to_array().map(f64::from)
}

fn vec3(v: [f64; 3]) -> Vec3 {
    // Finite, however strong the lights are.
    Vec3::from_array(v.map(|x| x as f32)).min(Vec3::MAX)
}
