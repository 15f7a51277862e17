//! The numbered parameters of a layer, looked at one by one, until none is left that says something
//! unknown.

use std::collections::BTreeMap;

use super::param::Layer;
use crate::error::UpsamplerError;

/// The parameters of a layer that have not been looked at.
pub struct Parameters<'a> {
    layer: &'a Layer,
    left: BTreeMap<u32, Vec<f64>>,
}

impl<'a> Parameters<'a> {
    /// All parameters of a layer.
    pub fn of(layer: &'a Layer) -> Self {
        Self {
            layer,
            left: layer.parameters.clone(),
        }
    }

    /// A number, or what it is where it is not given.
    pub fn number(&mut self, id: u32, default: f64) -> Result<f64, UpsamplerError> {
        // Removed, so that `finish` finds what nobody has asked for.
        match self.left.remove(&id).as_deref() {
            None => Ok(default),
            Some(&[value]) => Ok(value),
            Some(_) => Err(self
                .layer
                .wrong(format!("has a list as its parameter {id}"))),
        }
    }

    /// A whole number from 0 on.
    pub fn count(&mut self, id: u32, default: usize) -> Result<usize, UpsamplerError> {
        let value = self.number(id, default as f64)?;
        // Checked before the cast, which would turn -1 into 0 and cut fractions.
        let whole = value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value);
        if whole {
            Ok(value as usize)
        } else {
            Err(self
                .layer
                .wrong(format!("has {value} as its parameter {id}")))
        }
    }

    /// A list, or a single number as one; empty where it is not given.
    pub fn list(&mut self, id: u32) -> Vec<f64> {
        self.left.remove(&id).unwrap_or_default()
    }

    /// Refuses any other value of a parameter than this one.
    pub fn must_be(&mut self, id: u32, what: &str, value: usize) -> Result<(), UpsamplerError> {
        let given = self.number(id, value as f64)?;
        if given == value as f64 {
            return Ok(());
        }
        Err(self.layer.wrong(format!(
            "has {given} as its {what} (parameter {id}); supported is {value}"
        )))
    }

    /// Refuses parameters that nothing has looked at, unless they are 0 and so, in ncnn, as if they
    /// were not there.
    pub fn finish(self) -> Result<(), UpsamplerError> {
        match self
            .left
            .iter()
            .find(|(_, values)| values.iter().any(|&value| value != 0.0))
        {
            Some((id, values)) => Err(self.layer.wrong(format!(
                "has the parameter {id}={values:?}, which is not known here"
            ))),
            None => Ok(()),
        }
    }
}
