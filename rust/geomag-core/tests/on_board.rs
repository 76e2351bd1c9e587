//! The example that is carried on board, run to its end.

#[path = "../examples/on_board.rs"]
mod on_board;

#[test]
fn a_vehicle_comes_to_a_fix_and_navigates_on() {
    on_board::main().expect("nothing is refused");
}
