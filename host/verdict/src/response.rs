//! How the pressure of inspirations responds to the valve's commands: delay and play.

use engine::least_squares::solve;

/// Time between the values of the model, s, at least.
const STEP_S: f64 = 0.005;
/// Longest dead time that is tried, s.
const LONGEST_S: f64 = 0.06;
/// Lags of the valve that are tried, s.
const LAGS_S: [f64; 3] = [0.01, 0.025, 0.05];
/// Plays that are tried, percent of the full command.
const PLAYS: [f64; 9] = [0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0];
/// Time constants of lung and circuit in the model, s.
const POLES_S: [f64; 4] = [0.01, 0.04, 0.16, 0.64];
/// Columns of the model: a constant, and each time constant's response to the flow, and to its square.
const COLUMNS: usize = 1 + 2 * POLES_S.len();
/// Fewest values of a fit.
const FEWEST: usize = 60;

/// Command that starts a breath, percent, at least, and the time in which it comes, s: slower ones do not show a delay.
const JUMP_PERCENT: f64 = 15.0;
const JUMP_S: f64 = 0.01;
/// Rise of the pressure that shows that it responds, as a share of the way, and in standard deviations of the noise.
const RESPONDS: f64 = 0.03;
const RESPONDS_NOISE: f64 = 5.0;

/// Commands of the inspiratory valve, percent, and pressures, cmH2O, of one inspiration, tick by tick.
#[derive(Debug, Clone, PartialEq)]
pub struct Inspiration {
    /// Commands, percent.
    pub command: Vec<f64>,
    /// Pressures, cmH2O.
    pub pressure: Vec<f64>,
}

/// How the pressure responds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Response {
    /// Play of the valve, percent of the full command.
    pub play_percent: f64,
    /// Residual (rms) with this play as a share of that without any.
    pub with_play: f64,
}

impl Response {
    /// Fits the pressures by responses of first order to the command behind a dead time, a lag and a play, and takes those
    /// with the smallest residual. `None` with too few values or commands that do not move.
    pub fn fit(inspirations: &[Inspiration], period_s: f64) -> Option<Self> {
        let every = ((STEP_S / period_s).round() as usize).max(1);
        let step_s = every as f64 * period_s;
        let coarse: Vec<Inspiration> = inspirations.iter().map(|i| i.coarse(every)).collect();
        let best = |play: f64| {
            let longest = (LONGEST_S / step_s).floor() as usize;
            let all = LAGS_S.into_iter().flat_map(|lag| (0..=longest).map(move |dead| (dead, lag)));
            let fits = all.filter_map(|(dead, lag)| {
                residual(&coarse, step_s, |command| moved(command, dead, lag / step_s, play))
            });
            fits.min_by(f64::total_cmp)
        };
        let without = best(0.0)?;
        let plays = PLAYS.into_iter().filter_map(|play| Some((best(play)?, play)));
        let (residual, play_percent) = plays.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(Self { play_percent, with_play: residual / without })
    }
}

impl Inspiration {
    /// Means over this number of ticks.
    fn coarse(&self, every: usize) -> Self {
        let mean = |values: &[f64]| -> Vec<f64> {
            values.chunks_exact(every).map(|chunk| chunk.iter().sum::<f64>() / every as f64).collect()
        };
        Self { command: mean(&self.command), pressure: mean(&self.pressure) }
    }
}

/// Time from a command that jumps at the start of a breath to the response of the pressure, s; `way` is that from PEEP to the
/// level, `noise` the pressure's, cmH2O.
pub(super) fn onset(inspiration: &Inspiration, way: f64, noise: f64, period_s: f64) -> Option<f64> {
    let Inspiration { command, pressure } = inspiration;
    let ticks = ((JUMP_S / period_s).round() as usize).max(1).min(command.len());
    let jumps = command[..ticks].iter().position(|percent| *percent >= JUMP_PERCENT)?;
    let rise = (RESPONDS * way).max(RESPONDS_NOISE * noise);
    let responds = pressure.iter().position(|p| *p >= pressure[0] + rise)?;
    (responds > jumps).then(|| (responds - jumps) as f64 * period_s)
}

/// What a command moves behind a dead time, a lag, both in steps, and a play: it follows once the play is taken up.
fn moved(command: &[f64], dead: usize, lag: f64, play: f64) -> Vec<f64> {
    let (mut actuator, mut stem) = (0.0_f64, 0.0_f64);
    let share = 1.0 - (-1.0 / lag).exp();
    let follow = |n: usize| {
        let due = n.checked_sub(dead).map_or(0.0, |n| command[n]);
        actuator += share * (due - actuator);
        // Near the seat a spring takes up the play.
        stem = stem.max(actuator).min(actuator + play.min(actuator));
        stem
    };
    (0..command.len()).map(follow).collect()
}

/// Residual (rms) of the model with this valve, cmH2O.
fn residual(inspirations: &[Inspiration], step_s: f64, valve: impl Fn(&[f64]) -> Vec<f64>) -> Option<f64> {
    let (mut rows, mut pressures) = (Vec::new(), Vec::new());
    for Inspiration { command, pressure } in inspirations {
        let mut states = [0.0; COLUMNS - 1];
        for (moved, pressure) in valve(command).iter().zip(pressure) {
            let mut row = [1.0; COLUMNS];
            for (n, state) in states.iter_mut().enumerate() {
                let input = if n < POLES_S.len() { *moved } else { 0.01 * moved * moved };
                *state += (1.0 - (-step_s / POLES_S[n % POLES_S.len()]).exp()) * (input - *state);
                row[1 + n] = *state;
            }
            rows.push(row);
            pressures.push(*pressure);
        }
    }
    (rows.len() >= FEWEST).then(|| solve(&rows, &pressures)).flatten().map(|fit| fit.residual)
}
