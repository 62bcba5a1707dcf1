"""Networks that predict the GS-SDF itself: the paper's, and the baselines that it compares with (DeepSDF, pix2pix)."""
