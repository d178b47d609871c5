"""What a real robot needs beside its sensors: the state after the delay, and the pose of the base."""
