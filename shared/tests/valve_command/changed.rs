use shared::safety::filter::ValveCommand;

fn main() {
    let mut command = ValveCommand::SAFE;
    command.u_in = 80.0;
}
