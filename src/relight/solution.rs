//! The radiosity system for light that changes: B = S + rho F B from the last solution on.

use glam::Vec4;

use super::transport::Transport;

/// A solution that is kept warm. Values are RGB and a zero.
pub(super) struct Solution {
    /// Albedo of the patches, by row of the transport.
    pub albedo: Vec<Vec4>,
    /// First reflection of light, W/m2.
    pub source: Vec<Vec4>,
    /// Radiosity, W/m2, with the room that [`Transport::product`] asks for.
    pub radiosity: Vec<Vec4>,
    /// Irradiance from other patches, W/m2; after that of the last row stands a zero, for patches without a row.
    pub irradiance: Vec<Vec4>,
}

/// Parts of the patches that are brought up to date one after the other, each with what those before it have just got.
const BLOCKS: usize = 8;
/// Sweeps after which this gives up: another method must go on.
const MOST: usize = 40;

impl Solution {
    /// Of no light.
    pub fn new(transport: &Transport) -> Solution {
        let n = transport.len();
        Solution {
            albedo: vec![Vec4::ZERO; n],
            source: vec![Vec4::ZERO; n],
            radiosity: transport.vector(),
            irradiance: vec![Vec4::ZERO; n + 1],
        }
    }

    /// Solves from the last irradiance on, until what more sweeps would change is below `tolerance` times the sum of the
    /// radiosity. Tells the sweeps, and that change as a share; infinite where it was not reached.
    ///
    /// Block Gauss-Seidel: sums run in one order, so that the same start has the same end on any number of threads.
    pub fn solve(&mut self, transport: &Transport, tolerance: f64) -> (usize, f64) {
        for (k, b) in self.radiosity[..transport.len()].iter_mut().enumerate() {
            *b = self.source[k] + self.albedo[k] * self.irradiance[k];
        }
        let mut before = f64::INFINITY;
        for sweep in 1..=MOST {
            let (change, all) = self.sweep(transport);
            if all == 0.0 {
                return (sweep, 0.0);
            }
            // Changes fall by a steady factor q in the end; what is left is change (q + q^2 + ...).
            let q = change / before;
            let rest = if q < 1.0 { change / all * q / (1.0 - q) } else { f64::INFINITY };
            if sweep > 1 && rest <= tolerance || change == 0.0 {
                return (sweep, rest);
            }
            before = change;
        }
        (MOST, f64::INFINITY)
    }

    /// One sweep over the blocks: the sum of absolute changes of the radiosity, and the sum of its new values.
    fn sweep(&mut self, transport: &Transport) -> (f64, f64) {
        let n = transport.len();
        let block = n.div_ceil(BLOCKS).max(1);
        let (mut change, mut all) = (0.0, 0.0);
        for (first, out) in (0..).step_by(block).zip(self.irradiance[..n].chunks_mut(block)) {
            transport.product(&self.radiosity, first, out);
            let (mut moved, mut level) = (Vec4::ZERO, Vec4::ZERO);
            for (k, e) in (first..).zip(out) {
                let new = self.source[k] + self.albedo[k] * *e;
                moved += (new - self.radiosity[k]).abs();
                level += new;
                self.radiosity[k] = new;
            }
            change += moved.element_sum() as f64;
            all += level.element_sum() as f64;
        }
        (change, all)
    }
}
