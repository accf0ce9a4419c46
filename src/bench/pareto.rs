//! Which settings nothing else beats.

/// Whether each (time, error) is on the Pareto front: no other one is at most as slow and at most as wrong, and better in
/// one of both. Of equal ones the first counts; what is not finite is never on it.
pub fn front(points: &[(f64, f64)]) -> Vec<bool> {
    let sound = |(time, error): (f64, f64)| time.is_finite() && error.is_finite();
    let mut order: Vec<usize> = (0..points.len()).filter(|&i| sound(points[i])).collect();
    order.sort_by(|&a, &b| {
        let (p, q) = (points[a], points[b]);
        p.0.total_cmp(&q.0).then(p.1.total_cmp(&q.1)).then(a.cmp(&b))
    });
    let mut on = vec![false; points.len()];
    let mut least = f64::INFINITY;
    for i in order {
        if points[i].1 < least {
            least = points[i].1;
            on[i] = true;
        }
    }
    on
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_holds_what_nothing_beats() {
        let points = [(1.0, 5.0), (2.0, 3.0), (2.5, 4.0), (3.0, 3.0), (4.0, 1.0), (0.5, f64::NAN), (2.0, 3.0)];
        assert_eq!(front(&points), [true, true, false, false, true, false, false]);
        assert!(front(&[]).is_empty());
        assert_eq!(front(&[(f64::INFINITY, 0.0)]), [false]);
    }
}
