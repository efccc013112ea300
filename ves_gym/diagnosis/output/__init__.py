"""What a diagnosis writes: improved descriptions, closed-loop replay."""
