use shared::safety::filter::ValveCommand;

fn main() {
    let _ = ValveCommand { u_in: 80.0, u_out: false };
}
