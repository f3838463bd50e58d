//! The numbers among the results of a command: figures, and curves over the steps of a training.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A list whose name ends so is a curve, not figures.
pub const CURVE: &str = "curve";
/// The step of a point in a curve whose points have several values.
const STEP: &str = "iteration";

/// A number that changes during a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Steps, such as gradient steps or passes over a recording.
    pub steps: Vec<u64>,
    /// Value at each step.
    pub values: Vec<f64>,
}

impl Curve {
    /// Steps with their values.
    pub fn points(&self) -> impl Iterator<Item = (u64, f64)> {
        self.steps.iter().copied().zip(self.values.iter().copied())
    }

    fn push(&mut self, step: u64, value: f64) {
        self.steps.push(step);
        self.values.push(value);
    }
}

/// The numbers of a command's JSON. A name is the path to the number, as in `mean.learned` or `rounds.0.train_curve.validation`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// Numbers; true and false are 1 and 0.
    pub figures: BTreeMap<String, f64>,
    /// Lists whose name ends in `curve`: of numbers, which count as steps 1, 2 and so on, or of objects with an `iteration`.
    pub curves: BTreeMap<String, Curve>,
}

impl Results {
    /// The numbers in some JSON.
    pub fn of(json: &Value) -> Self {
        let mut results = Self::default();
        results.add("", json);
        results
    }

    fn add(&mut self, name: &str, value: &Value) {
        match value {
            Value::Object(fields) => {
                fields.iter().for_each(|(field, value)| self.add(&below(name, field), value));
            }
            Value::Array(points) if name.ends_with(CURVE) => self.add_curve(name, points),
            Value::Array(list) => {
                list.iter().enumerate().for_each(|(n, value)| self.add(&below(name, &n.to_string()), value));
            }
            Value::Bool(flag) => {
                self.figures.insert(name.to_owned(), f64::from(u8::from(*flag)));
            }
            Value::Number(_) => self.figures.extend(value.as_f64().map(|number| (name.to_owned(), number))),
            Value::Null | Value::String(_) => {}
        }
    }

    fn add_curve(&mut self, name: &str, points: &[Value]) {
        for (n, point) in points.iter().enumerate() {
            let step = point.get(STEP).and_then(Value::as_u64).unwrap_or(n as u64 + 1);
            let mut add = |name: String, value: &Value| {
                if let Some(value) = value.as_f64() {
                    self.curves.entry(name).or_default().push(step, value);
                }
            };
            match point {
                Value::Object(fields) => fields
                    .iter()
                    .filter(|(field, _)| *field != STEP)
                    .for_each(|(field, value)| add(below(name, field), value)),
                value => add(name.to_owned(), value),
            }
        }
    }
}

/// The name of a part.
fn below(name: &str, part: &str) -> String {
    if name.is_empty() { part.to_owned() } else { format!("{name}.{part}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn numbers_become_figures_and_lists_of_steps_become_curves() {
        let results = Results::of(&json!({
            "seed": 3,
            "improved": true,
            "plant": "R20C20",
            "missing": null,
            "rounds": [{
                "base": 1.5,
                "fit_curve": [0.5, 0.25],
                "train_curve": [
                    { "iteration": 10, "training": 1.0, "validation": 2.0 },
                    { "iteration": 20, "training": 0.5, "validation": null },
                ],
            }],
        }));
        let figures: Vec<_> = results.figures.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        assert_eq!(figures, [("improved", 1.0), ("rounds.0.base", 1.5), ("seed", 3.0)]);
        let curve = |name: &str| results.curves[name].points().collect::<Vec<_>>();
        assert_eq!(results.curves.len(), 3);
        assert_eq!(curve("rounds.0.fit_curve"), [(1, 0.5), (2, 0.25)]);
        assert_eq!(curve("rounds.0.train_curve.training"), [(10, 1.0), (20, 0.5)]);
        assert_eq!(curve("rounds.0.train_curve.validation"), [(10, 2.0)]);
    }
}
