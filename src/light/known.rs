//! What is known of receivers before a shadow ray is cast, and the rays that this spares.

use std::{
    ops::AddAssign,
    sync::atomic::{AtomicU64, Ordering::Relaxed},
};

use super::LightSet;
use crate::scene::SurfacePoint;

/// What stands before the points of a receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum View {
    /// Nobody knows.
    Unknown,
    /// No surface at all: every shadow ray arrives.
    Clear,
    /// None of this many rays around the point found the sky.
    NoSky(u32),
    /// All of this many rays around the point found the sky.
    AllSky(u32),
}

/// What a caller knows of the receivers.
pub struct Known<'a> {
    /// The view of a receiver's points.
    pub view: &'a (dyn Fn(&[SurfacePoint]) -> View + Sync),
    /// Whether rays that cannot bring light are left out; else they are cast, and change nothing.
    pub skip: bool,
    /// Counts which lamps reach anything.
    pub census: Option<&'a Census>,
}

impl Known<'_> {
    /// No receiver is known.
    pub const NOTHING: Known<'static> = Known { view: &|_| View::Unknown, skip: true, census: None };
}

/// Shadow rays that were not cast, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spared {
    /// The lamp lies behind the receiver or out of range, or the receiver behind the lamp: at least one ray a pair.
    pub away: u64,
    /// There is no sky, or a black one, in their direction.
    pub black_sky: u64,
    /// To lamps that reach nothing.
    pub dark_lamps: u64,
    /// No surface lies before the receiver.
    pub clear: u64,
    /// Receivers of these.
    pub clear_receivers: u64,
    /// The receiver sees no sky.
    pub no_sky: u64,
    /// The receiver sees nothing but sky.
    pub all_sky: u64,
    /// Sum over the receivers of the last two of the largest expected loss, in billionths of the light of an
    /// unoccluded sky. An integer, so that the sum does not depend on its order.
    pub sky_loss: u64,
}

impl Spared {
    /// Enters a receiver whose sky is taken from `rays` rays that all said the same.
    ///
    /// If a share p of the sky is otherwise, all of n rays miss that with a chance of (1 - p)^n; the expected loss
    /// p (1 - p)^n is largest at p = 1 / (n + 1), and then below 1 / (e n).
    pub(super) fn lose_sky(&mut self, rays: u32) {
        self.sky_loss += (1e9 / (std::f64::consts::E * rays.max(1) as f64)) as u64;
    }
}

impl AddAssign for Spared {
    fn add_assign(&mut self, o: Spared) {
        self.away += o.away;
        self.black_sky += o.black_sky;
        self.dark_lamps += o.dark_lamps;
        self.clear += o.clear;
        self.clear_receivers += o.clear_receivers;
        self.no_sky += o.no_sky;
        self.all_sky += o.all_sky;
        self.sky_loss += o.sky_loss;
    }
}

/// How many shadow rays went to each lamp, and how many arrived.
#[derive(Debug)]
pub struct Census {
    lamps: Vec<[AtomicU64; 2]>,
}

/// Rays without one that arrives, from which on a lamp is dark.
const ENOUGH: u64 = 1024;

impl Census {
    /// Of the lamps of `lights`; none where there are so many that receivers do not look at each.
    pub fn new(lights: &LightSet) -> Option<Census> {
        let lamps = lights.lamps.len();
        (lamps <= super::estimate::CUT).then(|| Census { lamps: (0..lamps).map(|_| Default::default()).collect() })
    }

    pub(super) fn enter(&self, lamp: u32, cast: u64, arrived: bool) {
        let [rays, arrivals] = &self.lamps[lamp as usize];
        rays.fetch_add(cast, Relaxed);
        arrivals.fetch_add(arrived as u64, Relaxed);
    }

    /// Lamps that many rays looked for and none found; and those rays.
    pub fn dark(&self) -> (Vec<bool>, u64) {
        let counts = self.lamps.iter().map(|[rays, arrivals]| (rays.load(Relaxed), arrivals.load(Relaxed)));
        let dark: Vec<(bool, u64)> = counts.map(|(rays, found)| (rays >= ENOUGH && found == 0, rays)).collect();
        let rays = dark.iter().filter(|d| d.0).map(|d| d.1).sum();
        (dark.into_iter().map(|d| d.0).collect(), rays)
    }
}
