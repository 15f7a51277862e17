//! Which timesteps a rule looks at, as shares of the schedule. Knows no rule.

use compute::Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::invalid_option::{InvalidOption, range};

/// How the timestep of a guidance step is chosen; the numbers are shares of the schedule's length.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub enum Timesteps {
    /// Falls linearly from `from` to `to` over the stage, the same for all views of a step
    /// (DiSR-NeRF).
    Annealed {
        /// Where the first step is; at least `to`.
        #[schemars(range(min = 0, max = 1))]
        from: f64,
        /// Where the step after the last would be.
        #[schemars(range(min = 0, max = 1))]
        to: f64,
    },
    /// Drawn anew for every view of every step, evenly between both ends.
    Uniform {
        /// The least noise.
        #[schemars(range(min = 0, max = 1))]
        min: f64,
        /// The most noise; at least `min`.
        #[schemars(range(min = 0, max = 1))]
        max: f64,
    },
}

impl Timesteps {
    /// From nearly pure noise to half-way, as DiSR-NeRF and the paper's code.
    pub const ANNEALED: Self = Self::Annealed {
        from: 0.98,
        to: 0.5,
    };
    /// All but the ends, as DreamFusion.
    pub const UNIFORM: Self = Self::Uniform {
        min: 0.02,
        max: 0.98,
    };

    /// Refuses shares outside 0 to 1 and ranges the wrong way round.
    pub fn check(&self) -> Result<(), InvalidOption> {
        match *self {
            Self::Annealed { from, to } => range("guidance.timesteps", to, from),
            Self::Uniform { min, max } => range("guidance.timesteps", min, max),
        }
    }

    /// The timesteps, all below `len`, that step `step` of `steps` uses for `views` views.
    pub fn at(&self, step: u64, steps: u32, views: usize, len: u32, rng: &Rng) -> Vec<u32> {
        // A share of 1 would be one beyond the last timestep.
        let timestep = |share: f64| ((share * f64::from(len)) as u32).min(len - 1);
        match *self {
            Self::Annealed { from, to } => {
                // The same for all views of a step, so that the schedule is applied to the batch as
                // a whole.
                let left = 1.0 - step as f64 / f64::from(steps);
                vec![timestep(to + left * (from - to)); views]
            }
            Self::Uniform { min, max } => {
                // Ends become whole numbers before one is drawn between them, so that both can be
                // drawn.
                let low = timestep(min);
                let high = timestep(max);
                (0..views as u64)
                    .map(|view| low + rng.below(step, view, high - low + 1))
                    .collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn annealing_falls_from_980_to_500_over_the_stage() {
        let at = |step| Timesteps::ANNEALED.at(step, 96, 2, 1000, &Rng::new(0, "test"));
        assert_eq!(
            [at(0), at(48), at(95)],
            [[980, 980], [740, 740], [505, 505]]
        );
    }

    #[test]
    fn uniform_timesteps_reach_both_ends_and_nothing_beyond() {
        let rng = Rng::new(0, "test");
        let drawn: Vec<u32> = (0..4000)
            .flat_map(|step| Timesteps::UNIFORM.at(step, 4000, 3, 1000, &rng))
            .collect();
        assert_eq!(
            (drawn.iter().min(), drawn.iter().max()),
            (Some(&20), Some(&980))
        );
    }

    #[test]
    fn a_share_of_one_is_the_last_timestep() {
        let all = Timesteps::Annealed { from: 1.0, to: 1.0 };
        assert_eq!(all.at(0, 10, 1, 1000, &Rng::new(0, "test")), [999]);
    }

    #[test]
    fn ranges_the_wrong_way_round_are_refused() {
        let message = |timesteps: Timesteps| timesteps.check().unwrap_err().to_string();
        assert_eq!(
            message(Timesteps::Annealed {
                from: 0.5,
                to: 0.98
            }),
            "`guidance.timesteps` reaches from 0.98 to 0.5; its ends are the wrong way round"
        );
        assert_eq!(
            message(Timesteps::Uniform { min: 0.1, max: 1.5 }),
            "`guidance.timesteps` is 1.5; it must be from 0 to 1"
        );
    }
}
