//! BiCGSTAB (van der Vorst 1992) on (1 - rho F) B = S, N channels side by side.
//!
//! Jacobi needs 1/(1 - rho) times as many sweeps as this; at albedo 0.999 that is 12,000. The stabilised conjugate
//! gradients need no symmetry, which estimated form factors do not have, and take two products a step.

use std::array::from_fn;

use rayon::{
    iter::{MaxLen, MinLen},
    prelude::*,
};

use super::product::Product;
use crate::transfer::FormFactors;

/// A solution and how it was found.
#[derive(Clone, Debug)]
pub struct Solution<const N: usize = 3> {
    /// Radiosity B, the unit of the source.
    pub radiosity: Vec<[f64; N]>,
    /// Irradiance E from other patches: B = S + rho E, and E = F B within the residual.
    pub irradiance: Vec<[f64; N]>,
    /// Steps, of the channel that took most.
    pub iterations: usize,
    /// max |S + rho F B - B| / max |S|.
    pub residual: f64,
}

/// Steps after which a restart is tried, and restarts after which what was reached is reported.
const MOST_STEPS: usize = 200;
const MOST_RESTARTS: usize = 20;
/// Plain bounces where the method breaks down.
const BOUNCES: usize = 50;
/// Rows that are one piece of work, and whose sums are added up together.
const BLOCK: usize = 512;

/// Solves B = S + rho F B until the residual is below `tolerance` times the largest source in each channel.
///
/// `albedo` (rho) and `source` (S) have one entry a patch, 0 <= rho < 1, S >= 0. f64 throughout; sums run over fixed
/// blocks: the same bits for any number of threads. The residual reached is in the result. The rows of `f` are unpacked for
/// it, into about as much memory as they take coded; not if they have left the memory (`spilled`), which is slower and
/// gives the same bits.
pub fn solve<const N: usize>(
    f: &FormFactors,
    albedo: &[[f64; N]],
    source: &[[f64; N]],
    tolerance: f64,
    spilled: bool,
) -> Solution<N> {
    let product = Product::new(f, source, spilled);
    let mut system = System { albedo: product.rows_of(albedo), source: product.rows_of(source), product };
    let scale = largest(&system.source);
    let mut x = system.product.vector_of(&system.source);
    let mut irradiance = vec![[0.0; N]; system.source.len()];
    let mut residual = [f64::INFINITY; N];
    let mut iterations = 0;
    for _ in 0..MOST_RESTARTS {
        let mut found = system.product.vector_of(&x[..system.source.len()]);
        // Half the tolerance: the recursive residual drifts from the true one.
        iterations += system.iterate(&mut found, scale, 0.5 * tolerance);
        let (next, error) = system.bounce(&found, scale);
        let good: [bool; N] = from_fn(|c| error[c] <= tolerance || error[c] < residual[c]);
        residual = from_fn(|c| if good[c] { error[c] } else { residual[c] });
        zip((&mut irradiance, &next)).for_each(|(e, next)| *e = from_fn(|c| if good[c] { next[c] } else { e[c] }));
        system.reflect(&irradiance, &mut x);
        if good.contains(&false) {
            // The method broke down. Bounces always come nearer, and begin the next attempt elsewhere.
            for _ in 0..BOUNCES {
                (irradiance, residual) = system.bounce(&x, scale);
                system.reflect(&irradiance, &mut x);
            }
            iterations += BOUNCES;
        }
        if residual.iter().all(|&r| r <= tolerance) {
            break;
        }
    }
    // What takes no part has no light of its own and gets none.
    let (mut radiosity, mut received) = (source.to_vec(), vec![[0.0; N]; source.len()]);
    for ((&i, b), e) in system.product.patches.iter().zip(x).zip(irradiance) {
        (radiosity[i as usize], received[i as usize]) = (b, e);
    }
    let residual = residual.into_iter().fold(0.0, f64::max);
    Solution { radiosity, irradiance: received, iterations, residual }
}

/// The system of the patches that take part. Vectors that are multiplied have room beyond their last row.
struct System<'a, const N: usize> {
    product: Product<'a, N>,
    albedo: Vec<[f64; N]>,
    source: Vec<[f64; N]>,
}

impl<const N: usize> System<'_, N> {
    /// E = F x, which is not negative, and max |S + rho E - x| / max |S| of every channel.
    fn bounce(&mut self, x: &[[f64; N]], scale: [f64; N]) -> (Vec<[f64; N]>, [f64; N]) {
        let mut next = vec![[0.0; N]; self.source.len()];
        self.product.multiply(x, &mut next);
        let rest = zip((&mut next, x, &self.source, &self.albedo)).map(|(e, x, s, a)| {
            *e = e.map(|e| e.max(0.0));
            from_fn(|c| s[c] + a[c] * e[c] - x[c])
        });
        let error: [f64; N] = most(rest);
        (next, from_fn(|c| if scale[c] > 0.0 { error[c] / scale[c] } else { 0.0 }))
    }

    /// x = S + rho E
    fn reflect(&self, irradiance: &[[f64; N]], x: &mut [[f64; N]]) {
        zip((x, &self.source, &self.albedo, irradiance)).for_each(|(x, s, a, e)| *x = from_fn(|c| s[c] + a[c] * e[c]));
    }

    /// Improves `x`; returns the number of steps.
    fn iterate(&mut self, x: &mut [[f64; N]], scale: [f64; N], tolerance: f64) -> usize {
        let System { product, albedo, source } = self;
        let n = source.len();
        let (mut v, mut t) = (vec![[0.0; N]; n], vec![[0.0; N]; n]);
        product.multiply(x, &mut v);
        let mut r = product.vector();
        zip((&mut r, &v, &*x, &*source, &*albedo))
            .for_each(|(r, v, x, s, a)| *r = from_fn(|c| s[c] - (x[c] - a[c] * v[c])));
        let (mut p, shadow) = (product.vector_of(&r[..n]), r[..n].to_vec());
        let [mut rho] = sums(zip((&r, &shadow)), |(r, q)| [times(r, q)]);
        let mut active = [true; N];
        for step in 0..MOST_STEPS {
            let worst = largest(&r[..n]);
            for c in 0..N {
                active[c] &= worst[c] > tolerance * scale[c];
            }
            if !active.contains(&true) {
                return step;
            }
            product.multiply(&p, &mut v);
            let [along] = sums(zip((&mut v, &p, &*albedo, &shadow)), |(v, p, a, q)| {
                *v = from_fn(|c| p[c] - a[c] * v[c]);
                [times(q, v)]
            });
            let alpha = quotient(rho, along, &mut active);
            zip((&mut r, &v)).for_each(|(r, v)| *r = from_fn(|c| r[c] - alpha[c] * v[c]));
            product.multiply(&r, &mut t);
            let [tr, tt] = sums(zip((&mut t, &r, &*albedo)), |(t, r, a)| {
                *t = from_fn(|c| r[c] - a[c] * t[c]);
                [times(t, r), times(t, t)]
            });
            let omega = quotient(tr, tt, &mut [true; N]);
            let [next] = sums(zip((&mut *x, &mut r, &p, &t, &shadow)), |(x, r, p, t, q)| {
                *x = from_fn(|c| x[c] + alpha[c] * p[c] + omega[c] * r[c]);
                *r = from_fn(|c| r[c] - omega[c] * t[c]);
                [times(q, r)]
            });
            let beta = quotient(from_fn(|c| next[c] * alpha[c]), from_fn(|c| rho[c] * omega[c]), &mut active);
            zip((&mut p, &r, &v)).for_each(|(p, r, v)| *p = from_fn(|c| r[c] + beta[c] * (p[c] - omega[c] * v[c])));
            rho = next;
        }
        MOST_STEPS
    }
}

/// a / b for the active channels, zero for the others; a breakdown ends its channel.
fn quotient<const N: usize>(a: [f64; N], b: [f64; N], active: &mut [bool; N]) -> [f64; N] {
    from_fn(|c| {
        let q = a[c] / b[c];
        active[c] &= q.is_finite();
        if active[c] { q } else { 0.0 }
    })
}

fn times<const N: usize>(a: &[f64; N], b: &[f64; N]) -> [f64; N] {
    from_fn(|c| a[c] * b[c])
}

/// Rows of several vectors side by side, up to the end of the shortest.
fn zip<T>(vectors: T) -> MaxLen<MinLen<T::Iter>>
where
    T: IntoParallelIterator<Iter: IndexedParallelIterator>,
{
    vectors.into_par_iter().with_min_len(BLOCK).with_max_len(4 * BLOCK)
}

/// Sums over blocks of fixed size, then over the blocks in order.
fn sums<R, const N: usize, const K: usize>(
    rows: impl IndexedParallelIterator<Item = R>,
    of: impl Fn(R) -> [[f64; N]; K] + Sync + Send,
) -> [[f64; N]; K] {
    let add = |sum: [[f64; N]; K], more: [[f64; N]; K]| from_fn(|k| from_fn(|c| sum[k][c] + more[k][c]));
    let blocks: Vec<[[f64; N]; K]> = rows.fold_chunks(BLOCK, || [[0.0; N]; K], |sum, row| add(sum, of(row))).collect();
    blocks.into_iter().fold([[0.0; N]; K], add)
}

/// Largest absolute value of each channel; infinite where there is one that is no number.
fn largest<const N: usize>(x: &[[f64; N]]) -> [f64; N] {
    most(zip(x).copied())
}

fn most<const N: usize>(rows: impl ParallelIterator<Item = [f64; N]>) -> [f64; N] {
    let size = |x: f64| if x.is_nan() { f64::INFINITY } else { x.abs() };
    let most = |a: [f64; N], b: [f64; N]| from_fn(|c| a[c].max(b[c]));
    rows.map(|x| x.map(size)).reduce(|| [0.0; N], most)
}

#[cfg(test)]
mod tests {
    use super::*;

    type Rgb = [f64; 3];
    use crate::sampling::hash;

    /// Gaussian elimination with partial pivoting.
    fn dense(f: &FormFactors, albedo: &[Rgb], source: &[Rgb], c: usize) -> Vec<f64> {
        let n = albedo.len();
        let mut rows: Vec<Vec<f64>> = (0..n)
            .map(|i| {
                let mut row = vec![0.0; n + 1];
                f.row(i).for_each(|(j, factor)| row[j] = -albedo[i][c] * factor);
                row[i] += 1.0;
                row[n] = source[i][c];
                row
            })
            .collect();
        for k in 0..n {
            let pivot = (k..n).max_by(|&i, &j| rows[i][k].abs().total_cmp(&rows[j][k].abs())).expect("a row");
            rows.swap(k, pivot);
            let own = rows[k].clone();
            for row in &mut rows[k + 1..] {
                let share = row[k] / own[k];
                (k..=n).for_each(|j| row[j] -= share * own[j]);
            }
        }
        let mut x = vec![0.0; n];
        for k in (0..n).rev() {
            let rest: f64 = (k + 1..n).map(|j| rows[k][j] * x[j]).sum();
            x[k] = (rows[k][n] - rest) / rows[k][k];
        }
        x
    }

    /// Solves, and compares with elimination: an error is at most the residual / (1 - the largest albedo), as no row
    /// sums to more than 1. The residual told is that before a last bounce, which makes it no larger.
    fn check(f: &FormFactors, albedo: &[Rgb], source: &[Rgb], what: &str) {
        let tolerance = 1e-9;
        let solution = solve(f, albedo, source, tolerance, false);
        assert!(solution.residual <= tolerance, "{what}: {solution:?}");
        let most = albedo.iter().flatten().copied().fold(0.0, f64::max);
        for c in 0..3 {
            let bound = (tolerance * largest(source)[c] + 1e-14) / (1.0 - most);
            for (i, expected) in dense(f, albedo, source, c).into_iter().enumerate() {
                let got = solution.radiosity[i][c];
                assert!((got - expected).abs() <= bound, "{what}: patch {i}, {got} for {expected}");
                assert!(got >= source[i][c]);
            }
        }
    }

    #[test]
    fn small_systems_agree_with_gaussian_elimination() {
        for seed in 0..300 {
            let mut k = 0;
            let mut random = || {
                k += 1;
                (hash(&[seed, k]) >> 40) as f64 / (1u64 << 24) as f64
            };
            let n = 1 + (random() * 30.0) as usize;
            let density = random();
            let closed = random() < 0.3;
            let white = if random() < 0.5 { 0.9999 } else { 0.8 };
            let rows: Vec<(Vec<u32>, u32)> = (0..n)
                .map(|_| {
                    let mut hit = || if random() < density { (random() * 400.0) as u32 } else { 0 };
                    let hits: Vec<u32> = (0..n).map(|_| hit()).collect();
                    (hits, if closed { 0 } else { hit() })
                })
                .collect();
            let mut colour = |most: f64| if random() < 0.2 { 0.0 } else { most * random().powf(0.1) };
            let albedo: Vec<Rgb> = (0..n).map(|_| [0; 3].map(|_| colour(white))).collect();
            // The third channel has no light.
            let source: Vec<Rgb> = (0..n).map(|_| [colour(1.0), colour(1e-9), 0.0]).collect();
            check(&FormFactors::of_hits(&rows), &albedo, &source, &format!("system {seed}"));
        }
    }

    #[test]
    fn rings_that_break_the_method_down_are_solved() {
        // Each patch sees the next one only: the residual is orthogonal to where it began until it has gone round.
        for (n, albedo) in [(2, 0.9999), (3, 0.999), (50, 0.99), (1000, 0.9)] {
            let rows: Vec<(Vec<u32>, u32)> =
                (0..n).map(|i| ((0..n).map(|j| (j == (i + 1) % n) as u32).collect(), 0)).collect();
            let mut source = vec![[0.0; 3]; n];
            source[0] = [1.0, 1e-30, 0.0];
            check(&FormFactors::of_hits(&rows), &vec![[albedo; 3]; n], &source, &format!("ring of {n}"));
        }
    }

    #[test]
    fn what_is_no_number_is_never_small() {
        assert_eq!(
            largest(&[[1.0, f64::NAN, -3.0], [f64::NEG_INFINITY, 2.0, 2.0]]),
            [f64::INFINITY, f64::INFINITY, 3.0]
        );
    }
}
