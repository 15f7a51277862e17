//! How much of the details of two images their sum should have, by least squares. Knows no images.

use compute::Array;

/// Sums of products of details over all pixels of all views.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    images_images: f64,
    images_own: f64,
    own_own: f64,
}

/// The parts of the details that the result has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shares {
    /// Of the network's detail, a.
    pub images: f64,
    /// Of the field's detail, b.
    pub own: f64,
}

impl Moments {
    /// Adds those of one view; both have the same shape, `[1, C, H, W]`, of whose pixels some may
    /// not count.
    pub fn add(&mut self, images: &Array, own: &Array, counts: Option<&[bool]>) {
        let values = images.to_vec();
        let pairs = values.iter().zip(own.to_vec()).enumerate();
        // Planes of channels lie one behind the other, and all have the same mask.
        let is_open = |i: usize| counts.is_none_or(|counts| counts[i % counts.len()]);
        for (_, (&n, o)) in pairs.filter(|(i, _)| is_open(*i)) {
            // In f64: a scene has more products than f32 could add up.
            self.images_images += f64::from(n) * f64::from(n);
            self.images_own += f64::from(n) * f64::from(o);
            self.own_own += f64::from(o) * f64::from(o);
        }
    }

    /// The shares (a, b) for which a n + b o is nearest the true detail t in the mean square,
    /// without knowing t.
    ///
    /// They solve the normal equations [nn no; no oo] (a, b) = (nt, ot). A network trained by
    /// squared error gives a conditional mean, whose product with the truth is its own square: nt =
    /// nn. For the field, ot = gain oo.
    pub fn shares(&self, gain: f64) -> Shares {
        let Self {
            images_images: nn,
            images_own: no,
            own_own: oo,
        } = *self;
        let determinant = nn * oo - no * no;
        // Without detail, or with the same twice, nothing tells the two apart.
        if determinant <= 1e-6 * nn * oo {
            return if oo > 0.0 && nn == 0.0 {
                Shares {
                    images: 0.0,
                    own: gain,
                }
            } else {
                Shares {
                    images: 1.0,
                    own: 0.0,
                }
            };
        }
        // Cramer's rule, with nt = nn and ot = gain oo.
        let images = oo * (nn - gain * no) / determinant;
        let own = (gain * nn * oo - no * nn) / determinant;
        // A negative share would take away what an image knows. Then the other one alone is best.
        match (images < 0.0, own < 0.0) {
            (true, _) => Shares {
                images: 0.0,
                own: gain,
            },
            (_, true) => Shares {
                images: 1.0,
                own: 0.0,
            },
            _ => Shares { images, own },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two estimates t = n + e of a truth, each the conditional mean given evidence of its own.
    #[test]
    fn independent_evidence_adds_up_and_the_same_evidence_does_not() {
        let independent = Moments {
            images_images: 1.0,
            images_own: 0.25,
            own_own: 1.0,
        };
        let shares = independent.shares(1.0);
        assert!(
            shares.images + shares.own > 1.5 && shares.images == shares.own,
            "{shares:?}"
        );
        let same = Moments {
            images_images: 2.0,
            images_own: 2.0,
            own_own: 2.0,
        };
        assert_eq!(
            same.shares(1.0),
            Shares {
                images: 1.0,
                own: 0.0
            }
        );
    }

    #[test]
    fn a_network_without_detail_leaves_the_field_alone_and_the_other_way_round() {
        let blind = Moments {
            images_images: 0.0,
            images_own: 0.0,
            own_own: 1.0,
        };
        assert_eq!(
            blind.shares(1.5),
            Shares {
                images: 0.0,
                own: 1.5
            }
        );
        let flat = Moments {
            images_images: 1.0,
            images_own: 0.0,
            own_own: 0.0,
        };
        assert_eq!(
            flat.shares(1.5),
            Shares {
                images: 1.0,
                own: 0.0
            }
        );
    }
}
