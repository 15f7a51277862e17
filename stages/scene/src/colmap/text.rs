//! COLMAP's text files: one record a line, `#` before comments. Knows nothing of the binary ones.

use std::str::FromStr;

use super::model::{Image, Model, Point, camera_to_world, lens, model_by_name};

/// The words of a line, taken one by one.
struct Words<'a>(std::str::SplitWhitespace<'a>);

impl<'a> Words<'a> {
    fn word(&mut self, what: &str) -> Result<&'a str, String> {
        self.0.next().ok_or_else(|| format!("{what} is missing"))
    }

    fn number<T: FromStr>(&mut self, what: &str) -> Result<T, String> {
        let word = self.word(what)?;
        word.parse()
            .map_err(|_| format!("{what} is `{word}`; expected a number"))
    }

    fn reals<const N: usize>(&mut self, what: &str) -> Result<[f64; N], String> {
        let mut reals = [0.0; N];
        for real in &mut reals {
            *real = self.number(what)?;
        }
        Ok(reals)
    }
}

/// Reads each line that is no comment, and says in which one something is wrong.
fn lines<'a>(
    bytes: &'a [u8],
    mut line: impl FnMut(Words<'a>, &mut dyn Iterator<Item = &'a str>) -> Result<(), String>,
) -> Result<(), (String, String)> {
    let text = std::str::from_utf8(bytes)
        .map_err(|error| ("the file".to_owned(), format!("is not UTF-8: {error}")))?;
    let mut numbered = text.lines().enumerate();
    while let Some((index, text)) = numbered.next() {
        if text.trim().is_empty() || text.starts_with('#') {
            continue;
        }
        let mut rest = numbered.by_ref().map(|(_, text)| text);
        line(Words(text.split_whitespace()), &mut rest)
            .map_err(|fault| (format!("line {}", index + 1), fault))?;
    }
    Ok(())
}

/// Reads `cameras.txt`: CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]. The error is a place and what is wrong there.
pub(super) fn cameras(bytes: &[u8], model: &mut Model) -> Result<(), (String, String)> {
    lines(bytes, |mut words, _| {
        let number = words.number("CAMERA_ID")?;
        let (name, count) = model_by_name(words.word("MODEL")?)?;
        let size = (words.number("WIDTH")?, words.number("HEIGHT")?);
        let parameters = (0..count)
            .map(|_| words.number("PARAMS"))
            .collect::<Result<Vec<f64>, _>>()?;
        model.lenses.insert(number, lens(name, size, &parameters)?);
        Ok(())
    })
}

/// Reads `images.txt`: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, each followed by a line of 2-D points, perhaps
/// empty.
pub(super) fn images(bytes: &[u8], model: &mut Model) -> Result<(), (String, String)> {
    lines(bytes, |mut words, rest| {
        let number = words.number("IMAGE_ID")?;
        let (turn, translation) = (words.reals("QW QX QY QZ")?, words.reals("TX TY TZ")?);
        let lens = words.number("CAMERA_ID")?;
        let first = words.word("NAME")?;
        // Names may hold spaces.
        let name = words
            .0
            .fold(first.to_owned(), |name, word| name + " " + word);
        rest.next();
        let camera_to_world =
            camera_to_world(turn, translation).map_err(|fault| format!("{name}: {fault}"))?;
        model.images.insert(
            number,
            Image {
                name,
                lens,
                camera_to_world,
            },
        );
        Ok(())
    })
}

/// Reads `points3D.txt`: POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID, POINT2D_IDX).
pub(super) fn points(bytes: &[u8], model: &mut Model) -> Result<(), (String, String)> {
    lines(bytes, |mut words, _| {
        words.word("POINT3D_ID")?;
        let position = words.reals("X Y Z")?;
        let _: [f64; 4] = words.reals("R G B ERROR")?;
        let mut seen_in = Vec::new();
        while let Some(image) = words.0.next() {
            seen_in.push(
                image
                    .parse()
                    .map_err(|_| format!("IMAGE_ID is `{image}`; expected a number"))?,
            );
            words.word("POINT2D_IDX")?;
        }
        model.points.push(Point { position, seen_in });
        Ok(())
    })
}
