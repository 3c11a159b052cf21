fn main() -> std::process::ExitCode {
    platelight::cli::main()
}
