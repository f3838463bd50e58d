//! Tests of what the supervisor makes of two pressure sensors that differ.

use super::*;

#[test]
fn a_sag_that_the_outlet_denies_raises_no_flow() {
    // The airway sensor reads 1.5 cmH2O too low, which is no difference that takes one out of use.
    let compensation = |outlet: f32| {
        let mut run = Run::new();
        for tick in (0..4).flat_map(|_| 0..breath().total_ticks()) {
            let inspires = breath().phase(tick) == Phase::Inspiration;
            let pressure = if inspires { 20.0 } else { 3.5 } + dither(tick);
            let outlet = if inspires { pressure } else { outlet + dither(tick + 1) };
            run.check_all(Readings { outlet, flow: 0.0, ..Readings::from(pressure) }, Some(tick));
            run.filter(ControlOutput::plain(0.0), !inspires);
        }
        run.state.expiration.compensation()
    };
    assert!(
        compensation(5.0) < 1.0 && compensation(3.8) > 20.0,
        "{} {}",
        compensation(5.0),
        compensation(3.8)
    );
}

#[test]
fn a_sensor_that_stays_up_in_the_fall_takes_no_other_out_of_use() {
    // The flow makes up for a leak; the outlet sensor stands at the plateau, and is found frozen.
    let mut run = Run::new();
    let readings = |tick: u32| {
        let inspires = breath().phase(tick) == Phase::Inspiration;
        let airway = if inspires && tick > 20 { 25.0 } else { 5.0 } + dither(tick);
        let outlet = if inspires { airway } else { 25.0 };
        Readings { outlet, flow: 0.0, ..Readings::from(airway) }
    };
    for tick in 0..2000 {
        let inspires = breath().phase(tick) == Phase::Inspiration;
        run.check_all(readings(tick), Some(tick));
        run.filter(ControlOutput::plain(50.0), !inspires);
        run.supervisor.lung.applied(&mut run.state.lung, 50.0);
    }
    assert!(run.check_all(readings(2000), Some(2000)).is_some_and(|pressure| pressure < 6.0));
}

#[test]
fn what_the_gas_denies_of_one_sensor_is_not_charged_to_the_next() {
    let (mut run, breath) = (Run::new(), breath());
    let (mut airway, mut believed) = (5.0_f32, None);
    for (number, tick) in (0..7).flat_map(|number| (0..breath.total_ticks()).map(move |tick| (number, tick)))
    {
        let inspires = breath.phase(tick) == Phase::Inspiration;
        let volume = run.state.lung.volume();
        airway = (5.0 + if inspires && tick > 0 { 0.05 * volume } else { 0.0 }).max(airway - 0.1);
        let flow = match tick {
            0..1000 => run.state.lung.valve_flow(),
            1000..1500 => -2e-3 * volume,
            _ => 0.0,
        };
        let stands = number > 3 || (number == 3 && tick >= 2000);
        let outlet = if stands { 40.0 } else { airway };
        let readings = Readings { airway: airway + dither(tick), outlet: outlet + dither(tick), flow };
        believed = run.check_all(readings, Some(tick));
        run.filter(ControlOutput::plain(30.0), !inspires);
        run.supervisor.end_tick(&mut run.state, &breath.at(tick), false);
    }
    assert!(believed.is_some_and(|pressure| pressure < 10.0), "{believed:?}");
}
