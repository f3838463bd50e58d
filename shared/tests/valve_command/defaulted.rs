use shared::safety::filter::ValveCommand;

fn main() {
    let _: ValveCommand = Default::default();
}
