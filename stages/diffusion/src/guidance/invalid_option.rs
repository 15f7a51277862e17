//! A number in the options that makes no sense, and the few questions asked of numbers. Knows no
//! option by name.

/// An option that makes no sense.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{field}` {problem}")]
pub struct InvalidOption {
    /// The field, as a path from the options: `guidance.lora_every`.
    pub field: &'static str,
    /// What is wrong and what would be right: "is 0; it must be at least 1".
    pub problem: String,
}

fn ask(
    holds: bool,
    field: &'static str,
    problem: impl FnOnce() -> String,
) -> Result<(), InvalidOption> {
    // Conditions say what must hold, never what must not: NaN fails each of them.
    if holds {
        Ok(())
    } else {
        Err(InvalidOption {
            field,
            problem: problem(),
        })
    }
}

/// A count that must not be 0.
pub(crate) fn at_least_one(field: &'static str, count: u32) -> Result<(), InvalidOption> {
    ask(count >= 1, field, || "is 0; it must be at least 1".into())
}

/// A number that must not be above another one.
pub(crate) fn at_most(field: &'static str, value: u32, limit: u32) -> Result<(), InvalidOption> {
    ask(value <= limit, field, || {
        format!("is {value}; it must be at most {limit}")
    })
}

/// A number that must be finite and above 0.
pub(crate) fn positive(field: &'static str, value: f64) -> Result<(), InvalidOption> {
    ask(value.is_finite() && value > 0.0, field, || {
        format!("is {value}; it must be a number above 0")
    })
}

/// A number that must be finite and not below 0.
pub(crate) fn not_negative(field: &'static str, value: f64) -> Result<(), InvalidOption> {
    ask(value.is_finite() && value >= 0.0, field, || {
        format!("is {value}; it must be 0 or a number above")
    })
}

/// A share of something, from 0 to 1.
pub(crate) fn share(field: &'static str, value: f64) -> Result<(), InvalidOption> {
    ask((0.0..=1.0).contains(&value), field, || {
        format!("is {value}; it must be from 0 to 1")
    })
}

/// A share of what was before, from 0 to below 1.
pub(crate) fn decay(field: &'static str, value: f64) -> Result<(), InvalidOption> {
    ask((0.0..1.0).contains(&value), field, || {
        format!("is {value}; it must be at least 0 and below 1")
    })
}

/// Two shares, the first not above the second.
pub(crate) fn range(field: &'static str, low: f64, high: f64) -> Result<(), InvalidOption> {
    share(field, low)?;
    share(field, high)?;
    ask(low <= high, field, || {
        format!("reaches from {low} to {high}; its ends are the wrong way round")
    })
}
