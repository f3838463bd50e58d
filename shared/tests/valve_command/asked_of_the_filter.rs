use shared::safety::filter::ValveCommand;

fn main() {
    let _ = ValveCommand::limited(80.0, false);
}
