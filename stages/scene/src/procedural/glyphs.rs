//! A 5x7 bitmap alphabet, and text set in it. Knows nothing of surfaces.

use glam::Vec2;

/// Cells from one letter to the next: five and a gap.
const ADVANCE: f32 = 6.0;
/// Cells from one line to the next: seven and leading.
const LEADING: f32 = 10.0;

/// Rows from the top, five bits each, the leftmost cell first. What is not in here is blank.
const ALPHABET: [(u8, [u8; 7]); 31] = [
    (
        b'A',
        [
            0b01110, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001,
        ],
    ),
    (
        b'B',
        [
            0b11110, 0b10001, 0b10001, 0b11110, 0b10001, 0b10001, 0b11110,
        ],
    ),
    (
        b'C',
        [
            0b01110, 0b10001, 0b10000, 0b10000, 0b10000, 0b10001, 0b01110,
        ],
    ),
    (
        b'D',
        [
            0b11100, 0b10010, 0b10001, 0b10001, 0b10001, 0b10010, 0b11100,
        ],
    ),
    (
        b'E',
        [
            0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b11111,
        ],
    ),
    (
        b'F',
        [
            0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b10000,
        ],
    ),
    (
        b'G',
        [
            0b01110, 0b10001, 0b10000, 0b10111, 0b10001, 0b10001, 0b01110,
        ],
    ),
    (
        b'H',
        [
            0b10001, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001,
        ],
    ),
    (
        b'I',
        [
            0b01110, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110,
        ],
    ),
    (
        b'J',
        [
            0b00111, 0b00010, 0b00010, 0b00010, 0b00010, 0b10010, 0b01100,
        ],
    ),
    (
        b'K',
        [
            0b10001, 0b10010, 0b10100, 0b11000, 0b10100, 0b10010, 0b10001,
        ],
    ),
    (
        b'L',
        [
            0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b11111,
        ],
    ),
    (
        b'M',
        [
            0b10001, 0b11011, 0b10101, 0b10101, 0b10001, 0b10001, 0b10001,
        ],
    ),
    (
        b'N',
        [
            0b10001, 0b11001, 0b11001, 0b10101, 0b10011, 0b10011, 0b10001,
        ],
    ),
    (
        b'O',
        [
            0b01110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110,
        ],
    ),
    (
        b'P',
        [
            0b11110, 0b10001, 0b10001, 0b11110, 0b10000, 0b10000, 0b10000,
        ],
    ),
    (
        b'Q',
        [
            0b01110, 0b10001, 0b10001, 0b10001, 0b10101, 0b10010, 0b01101,
        ],
    ),
    (
        b'R',
        [
            0b11110, 0b10001, 0b10001, 0b11110, 0b10100, 0b10010, 0b10001,
        ],
    ),
    (
        b'S',
        [
            0b01111, 0b10000, 0b10000, 0b01110, 0b00001, 0b00001, 0b11110,
        ],
    ),
    (
        b'T',
        [
            0b11111, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100,
        ],
    ),
    (
        b'U',
        [
            0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110,
        ],
    ),
    (
        b'V',
        [
            0b10001, 0b10001, 0b10001, 0b10001, 0b01010, 0b01010, 0b00100,
        ],
    ),
    (
        b'W',
        [
            0b10001, 0b10001, 0b10001, 0b10101, 0b10101, 0b11011, 0b10001,
        ],
    ),
    (
        b'X',
        [
            0b10001, 0b01010, 0b01010, 0b00100, 0b01010, 0b01010, 0b10001,
        ],
    ),
    (
        b'Y',
        [
            0b10001, 0b10001, 0b01010, 0b00100, 0b00100, 0b00100, 0b00100,
        ],
    ),
    (
        b'Z',
        [
            0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b10000, 0b11111,
        ],
    ),
    (
        b'4',
        [
            0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010,
        ],
    ),
    (b'.', [0, 0, 0, 0, 0, 0b01100, 0b01100]),
    (b',', [0, 0, 0, 0, 0b01100, 0b00100, 0b01000]),
    (b'-', [0, 0, 0, 0b11111, 0, 0, 0]),
    (
        b'?',
        [0b01110, 0b10001, 0b00001, 0b00110, 0b00100, 0, 0b00100],
    ),
];

/// Lines of capitals in cells of one size.
#[derive(Clone, Debug)]
pub(super) struct Text {
    pub(super) lines: Vec<&'static str>,
    /// The top left corner of the first letter; x to the right, y up.
    pub(super) top_left: Vec2,
    /// The side of a cell in world units: a letter is five by seven of them.
    pub(super) cell: f32,
}

impl Text {
    /// Text centred across `middle.x`, its first line's top at `middle.y`.
    pub(super) fn centred(line: &'static str, middle: Vec2, cell: f32) -> Text {
        let half = (ADVANCE * line.len() as f32 - 1.0) * cell / 2.0;
        Text {
            lines: vec![line],
            top_left: middle - Vec2::new(half, 0.0),
            cell,
        }
    }

    /// Whether there is ink at `at`.
    pub(super) fn inks(&self, at: Vec2) -> bool {
        let cells = (at - self.top_left) * Vec2::new(1.0, -1.0) / self.cell;
        // Negative numbers are cast to 0 and would repeat the first line and letter.
        if cells.min_element() < 0.0 {
            return false;
        }
        let line = (cells.y / LEADING) as usize;
        let column = (cells.x / ADVANCE) as usize;
        let letter = self
            .lines
            .get(line)
            .and_then(|line| line.as_bytes().get(column));
        letter.is_some_and(|letter| {
            inked(
                *letter,
                (cells.x % ADVANCE) as usize,
                (cells.y % LEADING) as usize,
            )
        })
    }
}

/// Whether a letter's cell is inked; columns from the left, rows from the top.
fn inked(letter: u8, column: usize, row: usize) -> bool {
    let found = ALPHABET.iter().find(|(known, _)| *known == letter);
    column < 5 && row < 7 && found.is_some_and(|(_, rows)| rows[row] >> (4 - column) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(text: &Text, columns: usize, rows: usize) -> Vec<String> {
        let at = |x: usize, y: usize| {
            text.top_left + text.cell * Vec2::new(x as f32 + 0.5, -(y as f32) - 0.5)
        };
        let line = |y| {
            (0..columns)
                .map(|x| if text.inks(at(x, y)) { '#' } else { '.' })
                .collect()
        };
        (0..rows).map(line).collect()
    }

    #[test]
    fn text_reads_from_the_top_left_in_lines() {
        let text = Text {
            lines: vec!["LT", "I"],
            top_left: Vec2::new(-3.0, 2.0),
            cell: 0.25,
        };
        let want = [
            "#.....#####",
            "#.......#..",
            "#.......#..",
            "#.......#..",
            "#.......#..",
            "#.......#..",
            "#####...#..",
            "...........",
            "...........",
            "...........",
            ".###.......",
        ];
        assert_eq!(drawn(&text, 11, 11), want);
    }

    #[test]
    fn there_is_no_ink_beside_the_text() {
        let text = Text::centred("HH", Vec2::ZERO, 1.0);
        assert!(text.inks(Vec2::new(-5.0, -0.5)) && text.inks(Vec2::new(5.0, -6.5)));
        for beside in [
            Vec2::new(-6.0, -0.5),
            Vec2::new(6.0, -0.5),
            Vec2::new(-5.0, 0.5),
            Vec2::new(-5.0, -7.5),
        ] {
            assert!(!text.inks(beside), "{beside}");
        }
    }
}
