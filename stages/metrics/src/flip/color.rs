//! The colour spaces of FLIP: an opponent space that is linear, in which the eye's blur is
//! computed, and CIELAB, in which differences are. The white point is D65, as sRGB's primaries give
//! it.

/// Linear sRGB to CIE XYZ.
// This matrix, its inverse and white are NVIDIA's, digit by digit: tests compare with its code.
const TO_XYZ: [[f64; 3]; 3] = [
    [
        10_135_552.0 / 24_577_794.0,
        8_788_810.0 / 24_577_794.0,
        4_435_075.0 / 24_577_794.0,
    ],
    [
        2_613_072.0 / 12_288_897.0,
        8_788_810.0 / 12_288_897.0,
        887_015.0 / 12_288_897.0,
    ],
    [
        1_425_312.0 / 73_733_382.0,
        8_788_810.0 / 73_733_382.0,
        70_074_185.0 / 73_733_382.0,
    ],
];
/// From XYZ to linear sRGB: the inverse of [`TO_XYZ`].
const FROM_XYZ: [[f64; 3]; 3] = [
    [3.241_003_275, -1.537_398_934, -0.498_615_861],
    [-0.969_224_334, 1.875_930_071, 0.041_554_224],
    [0.055_639_423, -0.204_011_202, 1.057_148_933],
];
/// XYZ of white, D65 at luminance 1.
const WHITE: [f64; 3] = [0.950_428_545, 1.0, 1.088_900_371];

/// YCxCz: luminance, red to green, yellow to blue; linear in light.
#[derive(Clone, Copy)]
pub struct Opponent(pub [f64; 3]);

/// CIELAB, its chroma reduced in the dark as Hunt found.
#[derive(Clone, Copy)]
pub struct Lab([f64; 3]);

impl Opponent {
    /// From an sRGB-encoded colour, 0 to 1.
    pub fn of_srgb(rgb: [f32; 3]) -> Self {
        Self::of_linear(rgb.map(|value| to_linear(f64::from(value))))
    }

    fn of_linear(rgb: [f64; 3]) -> Self {
        let [x, y, z] = relative_xyz(rgb);
        Self([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])
    }

    /// This colour brought into the range of the screen, in CIELAB.
    pub fn lab(self) -> Lab {
        let [luminance, red, yellow] = self.0;
        let y = (luminance + 16.0) / 116.0;
        let relative = [red / 500.0 + y, y, y - yellow / 200.0];
        let xyz = std::array::from_fn(|i| relative[i] * WHITE[i]);
        // The blur can leave the gamut. `largest_difference` bounds colours of the screen only.
        Lab::of_linear(product(&FROM_XYZ, xyz).map(|value| value.clamp(0.0, 1.0)))
    }
}

impl Lab {
    fn of_linear(rgb: [f64; 3]) -> Self {
        let [x, y, z] = relative_xyz(rgb).map(lightness);
        let l = 116.0 * y - 16.0;
        // In the dark colours look paler, so differences of chroma count less there.
        let hunt = 0.01 * l;
        Self([l, hunt * 500.0 * (x - y), hunt * 200.0 * (y - z)])
    }

    /// The distance HyAB: of lightness, and of chroma, added.
    pub fn difference(&self, other: &Self) -> f64 {
        // Lightness and chroma are added since a Euclidean distance fits large differences badly
        // (Abasi et al. 2020).
        let [l, a, b] = std::array::from_fn(|i| self.0[i] - other.0[i]);
        l.abs() + a.hypot(b)
    }
}

/// The largest difference of two colours of the screen: green from blue.
pub fn largest_difference() -> f64 {
    let green = Lab::of_linear([0.0, 1.0, 0.0]);
    green.difference(&Lab::of_linear([0.0, 0.0, 1.0]))
}

fn to_linear(value: f64) -> f64 {
    // The curve of IEC 61966-2-1, exact and in two pieces.
    if value <= 0.04045 {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    }
}

/// CIELAB's cube root, with a straight line near black.
fn lightness(value: f64) -> f64 {
    // At DELTA^3 the line has the root's value and slope; the root's own slope is infinite at 0.
    const DELTA: f64 = 6.0 / 29.0;
    if value > DELTA * DELTA * DELTA {
        value.cbrt()
    } else {
        value / (3.0 * DELTA * DELTA) + 4.0 / 29.0
    }
}

fn relative_xyz(rgb: [f64; 3]) -> [f64; 3] {
    let xyz = product(&TO_XYZ, rgb);
    std::array::from_fn(|i| xyz[i] / WHITE[i])
}

fn product(matrix: &[[f64; 3]; 3], vector: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| (0..3).map(|j| matrix[i][j] * vector[j]).sum())
}
