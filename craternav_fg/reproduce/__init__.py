"""The paper's static figures, regenerated, each beside what its equations and the bound allow."""
