//! The C export: whatever compiler builds it, its commands have the bits of the core.
//!
//! The computer's own compiler always runs. Clang, and a Cortex-M4F in QEMU, run with the feature `board`.

mod build;
mod operations;

use shared::control::Controller;
use shared::control::memory::SMALL_STEP;
use shared::safety::slew::Slew;
use shared::settings::{LEAST_RISE, Settings};
use shared::ventilator::Ventilator;

use build::{Place, compiler};
use learn::c_export::standalone::Standalone;
use operations::{Operations, drawn, shipped};
use tests::exact_lung::ExactLung;

/// Strict C99 without optimisation, and GNU C, in which GCC may fuse operations, with all that the processor has.
const PLAIN: [&str; 4] = ["-std=c99", "-pedantic", "-Wconversion", "-O0"];
const OPTIMISED: [&str; 3] = ["-std=gnu99", "-O2", "-march=native"];

#[test]
fn the_computers_compiler_gives_the_bits_of_the_core() {
    agree(&compiler("cc"), &PLAIN);
    agree(&compiler("cc"), &OPTIMISED);
}

#[test]
#[cfg(feature = "board")]
fn clang_gives_the_bits_of_the_core() {
    agree(&compiler("clang"), &PLAIN);
    agree(&compiler("clang"), &OPTIMISED);
}

#[test]
#[cfg(feature = "board")]
fn a_cortex_m4f_gives_the_bits_of_the_core() {
    agree(&build::chip(), &["-std=gnu99", "-O2"]);
}

#[test]
#[cfg(feature = "board")]
fn the_sketch_for_arduino_compiles_with_an_exported_controller() {
    let sketch = "examples/arduino/pressure_controller/pressure_controller.ino";
    Place::new(&shipped().take(1).collect::<Vec<_>>()).compile_sketch(sketch);
}

/// Builds the shipped controllers and drawn ones, and compares their answers with the core's.
#[track_caller]
fn agree(toolchain: &build::Toolchain, options: &[&str]) {
    let controllers: Vec<_> = shipped().chain((0..3).map(drawn)).collect();
    let operations = Operations::of(&controllers);
    let place = Place::new(&controllers);
    let answers = place.run(toolchain, options, operations.bytes());
    operations.compare(&answers);
}

/// What the file's self-check and these tests take for the core's results are those of a whole ventilator, as long as nothing happens
/// that only a supervisor notices.
#[test]
fn the_controller_alone_gives_the_commands_of_a_ventilator() {
    let (_, image) = shipped().next().expect("there is a shipped controller");
    let period_us = image.residual.spec().period_us;
    let ventilator = Ventilator::new(period_us, Controller::Residual(image.residual.clone()));
    let first = Settings { trigger_pressure: 0.0, trigger_flow: 0.0, ..Settings::default() };
    // The memory outlasts the first change and none of the others.
    let changes = [(20.0, 5.0, 0.0), (22.0, 5.0, 0.0), (30.0, 8.0, 0.0), (30.0, 8.0, 0.2)];
    let settings = changes.map(|(pip, peep, rise_time)| Settings { pip, peep, rise_time, ..first });
    let of_breath = |breath: u32| &settings[(breath as usize / 6).min(settings.len() - 1)];
    let mut state = ventilator.standby(&settings[0]).unwrap();
    state.start();
    let alone = Standalone::new(&image.residual);
    let mut alone_state = alone.initial_state();
    let mut lung = ExactLung::new(first.peep);
    let mut changed = 0;
    while state.breath_number() < 24 {
        if state.tick() == 0 {
            let now = of_breath(state.breath_number());
            ventilator.apply(&mut state, now).unwrap();
            lung.set_peep(now.peep);
            assert!(alone_state.is_due());
            alone.start_breath(&mut alone_state, now).unwrap();
        }
        let at = (state.breath_number(), state.tick());
        let output = ventilator.step(&mut state, lung.pressure());
        let command = alone.step(&mut alone_state, lung.pressure());
        let (u_in, u_out) = (output.command.u_in(), output.command.u_out());
        assert_eq!((command.u_in.to_bits(), command.u_out), (u_in.to_bits(), u_out), "{at:?}");
        changed += u32::from(output.sample.is_some_and(|sample| sample.learned.abs() > LEAST_RISE));
        lung.step(u_in, u_out);
    }
    assert!(changed > 1000, "the learned part must act: {changed}");
}

/// A table whose last bit is wrong does not pass.
#[test]
fn the_self_check_detects_a_changed_weight_and_a_changed_constant() {
    let controllers: Vec<_> = shipped().take(1).collect();
    let check = |from: &str, to: &str| {
        let place = Place::new(&controllers);
        place.change(&controllers[0].0, from, to);
        let answers = place.run(&compiler("cc"), &["-O1"], Operations::check().bytes());
        u32::from_ne_bytes(*answers.first_chunk().expect("an answer"))
    };
    assert_eq!(check("const", "const"), 0);
    let network = controllers[0].1.residual.network();
    let weight = network.hidden_2.weights[0][0];
    let weights = |weight: f32| format!("WEIGHTS_2[] = {{\n  {weight:?}f");
    let changed = |to: f32| check(&weights(weight), &weights(to));
    assert_eq!(changed(1.01 * weight), 1);
    assert_ne!(changed(f32::from_bits(weight.to_bits() ^ 1)), 0);
    // The script of the weights reaches neither the slew nor a change of settings, the trials do.
    let slew = Slew::new(controllers[0].1.residual.spec().period_us).per_tick();
    assert!(check(&format!("#define SLEW {slew:?}f"), "#define SLEW 20.0f") >= 2);
    assert!(check(&format!("#define SMALL_STEP {SMALL_STEP:?}f"), "#define SMALL_STEP 1.0f") >= 2);
}
