//! How far apart two files of numbers are: in units in the last place, and as PSNR. Knows nothing
//! of stages.

use std::path::Path;

use serde::Serialize;

use crate::content::{self, Values};

/// How far apart two arrays of one shape are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Distance {
    /// How many values there are.
    pub values: usize,
    /// How many of them differ.
    pub differ: usize,
    /// The greatest distance, counted in numbers of the arrays' precision that lie between.
    pub ulps: u64,
    /// Peak signal to noise ratio in dB; the peak is the greatest magnitude of the first array.
    pub psnr: f64,
}

/// How two files compare.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Comparison {
    /// The arrays that differ, by name; none if all are the same.
    Arrays(Vec<(String, Distance)>),
    /// They hold different things, or nothing that can be compared by number.
    Unlike,
}

/// Compares two files array by array.
pub fn files(a: &Path, b: &Path) -> Comparison {
    let (Ok(a), Ok(b)) = (content::values(a), content::values(b)) else {
        return Comparison::Unlike;
    };
    if !a.keys().eq(b.keys()) {
        return Comparison::Unlike;
    }
    let mut arrays = Vec::new();
    for (name, a) in &a {
        match distance(a, &b[name]) {
            Some(distance) if distance.differ > 0 => arrays.push((name.clone(), distance)),
            Some(_) => {}
            None => return Comparison::Unlike,
        }
    }
    Comparison::Arrays(arrays)
}

fn distance(a: &Values, b: &Values) -> Option<Distance> {
    match (a, b) {
        (Values::Single(a), Values::Single(b)) if a.len() == b.len() => {
            Some(measure(a.iter().zip(b).map(|(&a, &b)| {
                (f64::from(a), f64::from(b), ulps_single(a, b))
            })))
        }
        (Values::Double(a), Values::Double(b)) if a.len() == b.len() => Some(measure(
            a.iter().zip(b).map(|(&a, &b)| (a, b, ulps_double(a, b))),
        )),
        _ => None,
    }
}

fn measure(pairs: impl Iterator<Item = (f64, f64, u64)>) -> Distance {
    let mut values = 0;
    let mut differ = 0;
    let mut most = 0;
    let mut squares = 0.0;
    let mut peak = 0.0f64;
    for (a, b, ulps) in pairs {
        values += 1;
        // By ulps, not by `!=`: two NaNs are the same number here.
        differ += usize::from(ulps > 0);
        most = most.max(ulps);
        squares += (a - b) * (a - b);
        peak = peak.max(a.abs());
    }
    Distance {
        values,
        differ,
        ulps: most,
        // PSNR is 10 log10(peak² / MSE), with MSE = squares / values.
        psnr: 10.0 * (peak * peak * values as f64 / squares).log10(),
    }
}

/// How many steps from one number to the next lead from `a` to `b`. All NaNs are one, and so are
/// both zeros.
fn ulps_single(a: f32, b: f32) -> u64 {
    let place = |x: f32| {
        // Without the sign, bits count upwards with the number. With it put before them, neighbours
        // are one apart across zero.
        let bits = i64::from(x.to_bits() & 0x7fff_ffff);
        if x.is_sign_negative() { -bits } else { bits }
    };
    if a.is_nan() && b.is_nan() {
        0
    } else {
        place(a).abs_diff(place(b))
    }
}

/// The same for numbers of double precision.
fn ulps_double(a: f64, b: f64) -> u64 {
    let place = |x: f64| {
        let bits = (x.to_bits() & !(1 << 63)) as i64;
        if x.is_sign_negative() { -bits } else { bits }
    };
    if a.is_nan() && b.is_nan() {
        0
    } else {
        place(a).abs_diff(place(b))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_count_the_numbers_between() {
        assert_eq!(ulps_single(1.0, 1.0f32.next_up().next_up()), 2);
        assert_eq!(ulps_single(-0.0, 0.0), 0);
        assert_eq!(ulps_single(0.0f32.next_down(), 0.0f32.next_up()), 2);
        assert_eq!(ulps_single(f32::NAN, -f32::NAN), 0);
        assert_eq!(ulps_double(3.0, 3.0f64.next_down()), 1);
    }

    #[test]
    fn the_ratio_is_of_the_peak_to_the_mean_error() {
        let found = distance(
            &Values::Double(vec![2.0, 0.0]),
            &Values::Double(vec![2.0, 0.2]),
        )
        .unwrap();
        assert_eq!((found.values, found.differ), (2, 1));
        assert!(
            (found.psnr - 10.0 * (4.0f64 / 0.02).log10()).abs() < 1e-9,
            "{}",
            found.psnr
        );
        assert!(distance(&Values::Double(vec![]), &Values::Double(vec![1.0])).is_none());
    }

    #[test]
    fn files_of_json_are_compared_number_by_number() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            std::fs::write(folder.path().join(name), text).unwrap();
            folder.path().join(name)
        };
        let a = write(
            "a.json",
            r#"{"rows": {"x": 1.0, "y": [2, 3]}, "note": "a"}"#,
        );
        let b = write(
            "b.json",
            r#"{"rows": {"x": 1.0, "y": [2, 4]}, "note": "b"}"#,
        );
        let Comparison::Arrays(arrays) = files(&a, &b) else {
            panic!()
        };
        assert_eq!(
            arrays
                .iter()
                .map(|(name, _)| name.as_str())
                .collect::<Vec<_>>(),
            ["rows.y.1"]
        );
        assert_eq!(
            files(&a, &write("c.json", r#"{"rows": 1}"#)),
            Comparison::Unlike
        );
        assert_eq!(files(&a, &write("d.txt", "")), Comparison::Unlike);
    }
}
