//! Test lung: one or two compartments in parallel, each a parabolic resistor and a compliance that stiffens.

use super::branch::{Branch, parabolic_conductance};
use super::config::{CompartmentConfig, LungConfig};
use crate::math::sqrt;

/// One compartment and its state, the volume above the volume at rest.
#[derive(Clone, Debug)]
struct Compartment {
    /// Resistance in force.
    resistance: f64,
    /// The same without secretions and occlusion.
    clear_resistance: f64,
    turbulence: f64,
    /// Pressure per volume below the inflection, cmH2O/mL; stored because divisions dominate the sub-steps' time.
    stiffness: f64,
    inflection: f64,
    /// Relative rise of the elastance per cmH2O beyond the inflection.
    stiffening: f64,
    volume_ml: f64,
    sub_step_s: f64,
}

impl Compartment {
    fn new(config: &CompartmentConfig, pressure: f64, sub_step_s: f64) -> Self {
        let mut compartment = Self {
            resistance: config.resistance_cmh2o_per_l_s,
            clear_resistance: config.resistance_cmh2o_per_l_s,
            turbulence: config.turbulence_s_per_l,
            stiffness: 1.0 / config.compliance_ml_per_cmh2o,
            inflection: config.upper_inflection_cmh2o,
            stiffening: 1.0 / config.stiffening_cmh2o,
            volume_ml: 0.0,
            sub_step_s,
        };
        compartment.volume_ml = compartment.volume_at(pressure);
        compartment
    }

    /// Recoil in cmH2O and its slope, the elastance, in cmH2O/L: `V / C`, plus a parabola above the inflection.
    fn recoil(&self) -> (f64, f64) {
        let linear = self.volume_ml * self.stiffness;
        let beyond = (linear - self.inflection).max(0.0);
        let stiffer = beyond * self.stiffening;
        (linear + 0.5 * beyond * stiffer, 1e3 * self.stiffness * (1.0 + stiffer))
    }

    /// Volume in mL at which the recoil is `pressure`.
    fn volume_at(&self, pressure: f64) -> f64 {
        let above = pressure - self.inflection;
        let linear = if above > 0.0 {
            let width = 1.0 / self.stiffening;
            self.inflection + sqrt(width * width + 2.0 * width * above) - width
        } else {
            pressure
        };
        linear / self.stiffness
    }

    /// The compartment as a branch; its resistance includes the recoil's rise during the sub-step (implicit volume).
    fn branch(&self, airway_pressure: f64, muscle_pressure: f64) -> Branch {
        let (recoil, elastance) = self.recoil();
        let source = recoil - muscle_pressure;
        let linear = self.resistance + elastance * self.sub_step_s;
        let quadratic = self.resistance * self.turbulence;
        Branch { conductance: parabolic_conductance(linear, quadratic, airway_pressure - source), source }
    }
}

/// The lung and its state.
#[derive(Clone, Debug)]
pub(super) struct Lung {
    first: Compartment,
    second: Option<Compartment>,
    /// Factor of the secretions on every resistance.
    secretions: f64,
    /// Factor of a tube's occlusion on every resistance.
    occlusion: f64,
}

impl Lung {
    /// A lung at rest at `pressure`.
    #[inline(never)]
    pub(super) fn new(config: &LungConfig, pressure: f64, sub_step_s: f64) -> Self {
        Self {
            first: Compartment::new(&config.first, pressure, sub_step_s),
            second: config.second.as_ref().map(|second| Compartment::new(second, pressure, sub_step_s)),
            secretions: 1.0,
            occlusion: 1.0,
        }
    }

    /// Compartments as branches towards their alveolar pressure; an absent one has zero conductance.
    #[inline]
    pub(super) fn branches(&self, airway_pressure: f64, muscle_pressure: f64) -> [Branch; 2] {
        let second = self.second.as_ref();
        [
            self.first.branch(airway_pressure, muscle_pressure),
            second.map_or(Branch::default(), |second| second.branch(airway_pressure, muscle_pressure)),
        ]
    }

    /// Moves the volumes by one sub-step of `flows`, in L/s.
    pub(super) fn advance(&mut self, flows: [f64; 2]) {
        self.first.volume_ml += 1e3 * self.first.sub_step_s * flows[0];
        if let Some(second) = &mut self.second {
            second.volume_ml += 1e3 * second.sub_step_s * flows[1];
        }
    }

    /// Multiplies resistance and compliance. The volumes are recomputed so that the recoil does not jump: this models a
    /// stiffer lung at the same pressure, not expelled gas.
    pub(super) fn change(&mut self, resistance_factor: f64, compliance_factor: f64) {
        for compartment in core::iter::once(&mut self.first).chain(&mut self.second) {
            compartment.clear_resistance *= resistance_factor;
            compartment.stiffness /= compliance_factor;
            compartment.volume_ml *= compliance_factor;
        }
        self.narrow();
    }

    /// Sets the factor of the secretions on every resistance.
    pub(super) fn set_secretions(&mut self, factor: f64) {
        self.secretions = factor;
        self.narrow();
    }

    /// Sets the factor of the tube's occlusion on every resistance; 1 for an open tube.
    pub(super) fn occlude(&mut self, factor: f64) {
        self.occlusion = factor;
        self.narrow();
    }

    fn narrow(&mut self) {
        for compartment in core::iter::once(&mut self.first).chain(&mut self.second) {
            compartment.resistance = compartment.clear_resistance * self.secretions * self.occlusion;
        }
    }

    /// Volume above the volume at rest, mL.
    pub(super) fn volume_ml(&self) -> f64 {
        self.first.volume_ml + self.second.as_ref().map_or(0.0, |second| second.volume_ml)
    }

    /// Recoil minus muscle pressure, weighted by compliance, cmH2O.
    pub(super) fn alveolar_pressure(&self, muscle_pressure: f64) -> f64 {
        let (mut weighted, mut compliance) = (0.0, 0.0);
        for compartment in core::iter::once(&self.first).chain(&self.second) {
            weighted += compartment.recoil().0 / compartment.stiffness;
            compliance += 1.0 / compartment.stiffness;
        }
        weighted / compliance - muscle_pressure
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SUB_STEP_S: f64 = 0.000_25;

    fn compartment(pressure: f64) -> Compartment {
        Compartment::new(&CompartmentConfig::default(), pressure, SUB_STEP_S)
    }

    #[test]
    fn compliance_is_linear_below_the_inflection() {
        let lung = compartment(20.0);
        assert!((lung.volume_ml - 400.0).abs() < 1e-9);
        assert!((lung.recoil().0 - 20.0).abs() < 1e-9);
        assert!((lung.recoil().1 - 50.0).abs() < 1e-9);
    }

    #[test]
    fn stiffens_smoothly_above_the_inflection() {
        let config = CompartmentConfig::default();
        let mut lung = compartment(0.0);
        let knee_ml = config.upper_inflection_cmh2o * config.compliance_ml_per_cmh2o;
        lung.volume_ml = knee_ml + config.stiffening_cmh2o * config.compliance_ml_per_cmh2o;
        assert!((lung.recoil().1 / 50.0 - 2.0).abs() < 1e-9, "elastance doubles over the stiffening width");
        for volume_ml in [knee_ml - 1.0, knee_ml + 1.0, knee_ml + 200.0] {
            lung.volume_ml = volume_ml + 1e-3;
            let above = lung.recoil().0;
            lung.volume_ml = volume_ml - 1e-3;
            let slope = (above - lung.recoil().0) / 2e-6;
            lung.volume_ml = volume_ml;
            assert!((slope / lung.recoil().1 - 1.0).abs() < 1e-5, "elastance is the slope of the recoil");
        }
    }

    #[test]
    fn volume_inverts_the_recoil() {
        for pressure in [-5.0, 0.0, 20.0, 34.9, 35.1, 60.0, 120.0] {
            assert!((compartment(pressure).recoil().0 - pressure).abs() < 1e-9, "{pressure} cmH2O");
        }
    }

    #[test]
    fn resistor_is_parabolic() {
        let lung = Compartment { sub_step_s: 0.0, ..compartment(0.0) };
        let config = CompartmentConfig::default();
        for flow in [0.05_f64, 0.5, 1.0] {
            let drop = config.resistance_cmh2o_per_l_s * flow * (1.0 + config.turbulence_s_per_l * flow);
            assert!((lung.branch(drop, 0.0).flow(drop) + flow).abs() < 1e-9);
        }
    }

    #[test]
    fn a_lung_quicker_than_the_sub_step_does_not_overshoot() {
        let quick = CompartmentConfig {
            resistance_cmh2o_per_l_s: 0.5,
            compliance_ml_per_cmh2o: 0.2,
            ..CompartmentConfig::default()
        };
        let mut lung = Lung::new(&LungConfig { first: quick, second: None }, 5.0, SUB_STEP_S);
        for _ in 0..20 {
            let [branch, _] = lung.branches(10.0, 0.0);
            lung.advance([-branch.flow(10.0), 0.0]);
            assert!(lung.alveolar_pressure(0.0) <= 10.0 + 1e-9);
        }
        assert!((lung.alveolar_pressure(0.0) - 10.0).abs() < 0.01);
    }

    #[test]
    fn muscle_pressure_lowers_the_alveolar_pressure() {
        let lung = Lung::new(&LungConfig::default(), 5.0, SUB_STEP_S);
        assert!((lung.alveolar_pressure(3.0) - 2.0).abs() < 1e-9);
        assert!(lung.branches(5.0, 3.0)[0].flow(5.0) < 0.0, "gas goes into the lung");
    }

    #[test]
    fn change_secretions_and_occlusion_multiply_every_resistance() {
        let config = LungConfig { second: Some(CompartmentConfig::default()), ..LungConfig::default() };
        let mut lung = Lung::new(&config, 5.0, SUB_STEP_S);
        lung.occlude(10.0);
        lung.set_secretions(1.5);
        lung.change(2.0, 1.0);
        let resistances = |lung: &Lung| [lung.first.resistance, lung.second.as_ref().unwrap().resistance];
        assert!(resistances(&lung).iter().all(|r| (r - 600.0).abs() < 1e-9));
        lung.occlude(1.0);
        assert!(resistances(&lung).iter().all(|r| (r - 60.0).abs() < 1e-9), "20 x 1.5 x 2");
    }

    #[test]
    fn a_change_of_compliance_keeps_the_pressure() {
        let mut lung = Lung::new(&LungConfig::default(), 40.0, SUB_STEP_S);
        let before = lung.volume_ml();
        lung.change(1.0, 0.5);
        assert!((lung.alveolar_pressure(0.0) - 40.0).abs() < 1e-9);
        assert!((lung.volume_ml() - 0.5 * before).abs() < 1e-9);
    }
}
