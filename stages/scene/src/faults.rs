//! Photos that cannot be used, and how many of them a scene can do without. Knows no formats.

use std::path::Path;

use crate::SceneError;

/// What was left out of a file of poses: which photo, and what is wrong with it.
#[derive(Default)]
pub(crate) struct Faults(Vec<(String, String)>);

impl Faults {
    pub(crate) fn add(&mut self, place: impl Into<String>, fault: impl Into<String>) {
        self.0.push((place.into(), fault.into()));
    }

    /// Notes for what is left out of `count` photos; an error if that is more than a tenth of them.
    pub(crate) fn settle(self, path: &Path, count: usize) -> Result<Vec<String>, SceneError> {
        let Some((place, fault)) = self.0.first() else {
            return Ok(Vec::new());
        };
        let many = self.0.len();
        // One broken photo must not stop a scene, but many mean that the file is read wrongly.
        if many <= a_tenth(count) {
            let note = |(place, fault): &(String, String)| {
                format!("{}: {place} is left out: {fault}", path.display())
            };
            return Ok(self.0.iter().map(note).collect());
        }
        let also = match many {
            1 => String::new(),
            _ => format!(" (and {} more of {count} photos)", many - 1),
        };
        Err(SceneError::content(path, place, format!("{fault}{also}")))
    }
}

/// How many photos of so many may be left out: a tenth, rounded to the nearest number.
pub(crate) fn a_tenth(count: usize) -> usize {
    (count + 5) / 10
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenth_is_left_out_and_more_is_refused() {
        let settle = |faults: usize, count: usize| {
            let mut all = Faults::default();
            (0..faults).for_each(|i| all.add(format!("frame {i}"), "is bad"));
            all.settle(Path::new("t.json"), count)
        };
        assert_eq!(settle(0, 3).unwrap(), Vec::<String>::new());
        assert_eq!(
            settle(1, 9).unwrap(),
            ["t.json: frame 0 is left out: is bad"]
        );
        assert_eq!(settle(10, 100).unwrap().len(), 10);
        assert_eq!(
            settle(1, 3).unwrap_err().to_string(),
            "t.json: frame 0: is bad"
        );
        assert_eq!(
            settle(11, 100).unwrap_err().to_string(),
            "t.json: frame 0: is bad (and 10 more of 100 photos)"
        );
    }
}
