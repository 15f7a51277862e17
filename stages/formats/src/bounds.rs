//! The box that a scene fills. Knows no cameras.

/// Lowest and highest corner of an axis-aligned box, in scene units.
pub type Bounds = [[f64; 3]; 2];

/// The smallest box around all points. That of none is empty: its low corner lies above its high
/// one.
pub fn around(points: impl IntoIterator<Item = [f64; 3]>) -> Bounds {
    // Infinities are neutral for min and max, so the first point needs no case of its own.
    let empty = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    points.into_iter().fold(empty, |[low, high], p| {
        [
            std::array::from_fn(|i| low[i].min(p[i])),
            std::array::from_fn(|i| high[i].max(p[i])),
        ]
    })
}

/// The first of the box's numbers that JSON cannot hold.
pub fn not_finite(bounds: &Bounds) -> Option<f64> {
    let mut numbers = bounds.as_flattened().iter().copied();
    numbers.find(|number| !number.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_holds_its_points_and_no_more() {
        let points = [[1.0, 5.0, -2.0], [0.0, 7.0, 3.0]];
        assert_eq!(around(points), [[0.0, 5.0, -2.0], [1.0, 7.0, 3.0]]);
        assert_eq!(not_finite(&around(points)), None);
        assert_eq!(not_finite(&around([])), Some(f64::INFINITY));
    }
}
