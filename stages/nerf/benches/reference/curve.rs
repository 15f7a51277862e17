//! Draws PSNR over time as an SVG. Knows curves and ink, and nothing of what was measured.

use crate::Mark;
use std::fmt::Write;

const SIZE: [f64; 2] = [640.0, 400.0];
const MARGIN: [f64; 2] = [56.0, 44.0];
const INKS: [&str; 2] = ["#c2410c", "#1d4ed8"];

/// Curves by name over logarithmic time.
pub fn svg(curves: &[(&str, &[Mark])]) -> String {
    let marks = || curves.iter().flat_map(|(_, marks)| marks.iter());
    let range = |value: fn(&Mark) -> f64| {
        marks()
            .map(value)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| {
                [low.min(x), high.max(x)]
            })
    };
    let seconds = range(|mark| mark.seconds.log10()).map(f64::floor);
    let axes = Axes {
        x: [seconds[0], seconds[1] + 1.0],
        y: [
            even(range(|m| m.psnr)[0], f64::floor),
            even(range(|m| m.psnr)[1], f64::ceil),
        ],
    };
    let mut svg = axes.frame();
    for (i, (name, marks)) in curves.iter().enumerate() {
        let points: Vec<String> = marks
            .iter()
            .map(|mark| axes.place(mark.seconds.log10(), mark.psnr))
            .collect();
        let ink = INKS[i % INKS.len()];
        _ = writeln!(
            svg,
            r#"<polyline points="{}" fill="none" stroke="{ink}" stroke-width="2"/>"#,
            points.join(" ")
        );
        let y = SIZE[1] - MARGIN[1] - 14.0 - 18.0 * (curves.len() - 1 - i) as f64;
        let x = SIZE[0] - 24.0;
        _ = writeln!(
            svg,
            r#"<text x="{x}" y="{y}" text-anchor="end" fill="{ink}">{name}</text>"#
        );
    }
    svg + "</svg>\n"
}

fn even(x: f64, round: fn(f64) -> f64) -> f64 {
    2.0 * round(x / 2.0)
}

/// The ranges of log10 seconds and of dB.
struct Axes {
    x: [f64; 2],
    y: [f64; 2],
}

impl Axes {
    fn at(&self, x: f64, y: f64) -> [f64; 2] {
        let part = |value: f64, [low, high]: [f64; 2]| (value - low) / (high - low);
        let [width, height] = [SIZE[0] - MARGIN[0] - 16.0, SIZE[1] - MARGIN[1] - 16.0];
        [
            MARGIN[0] + width * part(x, self.x),
            16.0 + height * (1.0 - part(y, self.y)),
        ]
    }

    fn place(&self, x: f64, y: f64) -> String {
        let [x, y] = self.at(x, y);
        format!("{x:.1},{y:.1}")
    }

    /// The start of the picture: paper, grid and labels.
    fn frame(&self) -> String {
        let [width, height] = SIZE;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
             font-size=\"13\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
        );
        for exponent in self.x[0] as i32..=self.x[1] as i32 {
            let [x, bottom] = self.at(f64::from(exponent), self.y[0]);
            svg += &line([x, bottom], self.at(f64::from(exponent), self.y[1]));
            let seconds = 10f64.powi(exponent);
            _ = writeln!(
                svg,
                r#"<text x="{x:.1}" y="{:.1}" text-anchor="middle">{seconds} s</text>"#,
                bottom + 18.0
            );
        }
        for psnr in (self.y[0] as i32..=self.y[1] as i32).step_by(2) {
            let [left, y] = self.at(self.x[0], f64::from(psnr));
            svg += &line([left, y], self.at(self.x[1], f64::from(psnr)));
            _ = writeln!(
                svg,
                r#"<text x="{:.1}" y="{:.1}" text-anchor="end">{psnr} dB</text>"#,
                left - 6.0,
                y + 4.0
            );
        }
        svg
    }
}

fn line([x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) -> String {
    format!("<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"#ddd\"/>\n")
}
