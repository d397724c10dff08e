//! Plane geometry of the wavelength cloud.
//!
//! Orientation of o, a, b: (a - o) x (b - o) > 0 where they turn left; a point is inside a
//! counter-clockwise hull where it lies left of all edges. Distance from an edge: |p - (a + t (b -
//! a))|, t = clamp((p - a) . (b - a) / |b - a|^2, 0, 1). Source: A. Andrew, Inf. Process. Lett. 9
//! (1979), the monotone chain.

/// Mean of the points and root-mean-square deviation of a coordinate from it.
pub(crate) fn centre_and_spread(points: &[[f64; 2]]) -> ([f64; 2], f64) {
    let n = points.len().max(1) as f64;
    let centre = [0, 1].map(|c| points.iter().map(|p| p[c]).sum::<f64>() / n);
    // Half of the mean squared distance is the variance of one coordinate.
    let square: f64 = points
        .iter()
        .map(|p| (p[0] - centre[0]).powi(2) + (p[1] - centre[1]).powi(2))
        .sum();
    (centre, (square / (2.0 * n)).sqrt())
}

/// Largest distance between two points.
pub(crate) fn diameter(points: &[[f64; 2]]) -> f64 {
    // The farthest two are vertices of the hull.
    let hull = convex_hull(points);
    let mut largest: f64 = 0.0;
    for (i, a) in hull.iter().enumerate() {
        for b in &hull[i + 1..] {
            largest = largest.max(distance(*a, *b));
        }
    }
    largest
}

/// Euclidean distance.
pub(crate) fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn cross(o: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])
}

/// Convex hull, counter-clockwise (Andrew's monotone chain); one or two vertices where the points
/// coincide or lie on a line.
pub(crate) fn convex_hull(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut sorted: Vec<[f64; 2]> = points.to_vec();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    sorted.dedup();
    if sorted.len() < 3 {
        return sorted;
    }
    // Lower and upper half: whatever makes the chain turn right lies inside.
    let half = |points: &mut dyn Iterator<Item = &[f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while chain.len() >= 2
                && cross(chain[chain.len() - 2], chain[chain.len() - 1], *p) <= 0.0
            {
                chain.pop();
            }
            chain.push(*p);
        }
        chain.pop();
        chain
    };
    let mut hull = half(&mut sorted.iter());
    hull.extend(half(&mut sorted.iter().rev()));
    hull
}

/// Distance from a point to a convex polygon (counter-clockwise), 0 inside.
pub(crate) fn distance_to_polygon(vertices: &[[f64; 2]], p: [f64; 2]) -> f64 {
    let n = vertices.len();
    let edges = || (0..n).map(|i| (vertices[i], vertices[(i + 1) % n]));
    if n >= 3 && edges().all(|(a, b)| cross(a, b, p) >= 0.0) {
        return 0.0;
    }
    edges()
        .map(|(a, b)| distance_to_segment(a, b, p))
        .fold(f64::INFINITY, f64::min)
}

fn distance_to_segment(a: [f64; 2], b: [f64; 2], p: [f64; 2]) -> f64 {
    let along = [b[0] - a[0], b[1] - a[1]];
    let square = along[0].powi(2) + along[1].powi(2);
    // Foot of the perpendicular, held within the edge.
    let t = if square > 0.0 {
        (((p[0] - a[0]) * along[0] + (p[1] - a[1]) * along[1]) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    distance(p, [a[0] + t * along[0], a[1] + t * along[1]])
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [[f64; 2]; 6] = [
        [0.0, 0.0],
        [1.0, 0.0],
        [1.0, 1.0],
        [0.0, 1.0],
        [0.5, 0.5],
        [0.5, 0.0],
    ];

    #[test]
    fn hull_of_a_square_has_its_four_corners() {
        assert_eq!(convex_hull(&SQUARE).len(), 4);
        assert!((diameter(&SQUARE) - 2.0_f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn distance_is_zero_inside_and_euclidean_outside() {
        let hull = convex_hull(&SQUARE);
        assert_eq!(distance_to_polygon(&hull, [0.2, 0.9]), 0.0);
        assert!((distance_to_polygon(&hull, [1.5, 0.5]) - 0.5).abs() < 1e-15);
        assert!((distance_to_polygon(&hull, [2.0, 2.0]) - 2.0_f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn points_on_a_line_make_a_segment() {
        let hull = convex_hull(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]);
        assert_eq!(hull.len(), 2);
        assert!((distance_to_polygon(&hull, [1.0, 1.0])).abs() < 1e-15);
        assert!((distance_to_polygon(&hull, [2.0, 0.0]) - 2.0_f64.sqrt()).abs() < 1e-15);
        assert!((distance_to_polygon(&convex_hull(&[[1.0, 1.0]]), [1.0, 3.0]) - 2.0).abs() < 1e-15);
    }
}
